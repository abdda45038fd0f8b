import io
import re
import zlib

import matplotlib as mpl
import pytest
from fontTools.ttLib import TTFont
from matplotlib.figure import Figure

from rrmctl.cli.report import Across, Drawing
from rrmctl.reports.figure_layout import WIDEST, encode
from rrmctl.reports.figures.box import box_plot
from rrmctl.reports.figures.curves import learning_curves
from tests.rrmctl.reports import scenes
from tests.rrmctl.reports.frames import Sweep


@pytest.mark.parametrize("form", [form.value for form in Drawing])
def test_equal_figures_give_equal_bytes(form):
    """No date or random name enters the file; drawing leaves matplotlib's global settings alone."""
    before = dict(mpl.rcParams)
    one, two = (encode(box_plot(*Sweep().frames()), form) for _ in range(2))
    assert one == two
    assert dict(mpl.rcParams) == before


def test_fonts_are_embedded_in_the_pdf():
    """Every font of the PDF is a TrueType font that lies in the file with its outlines; none is of Type 3."""
    data = encode(learning_curves(*Sweep().frames()), "pdf")
    assert b"/Type3" not in data
    assert b"/CIDFontType2" in data
    numbers = re.findall(rb"/FontFile2 (\d+) 0 R", data)
    assert len(numbers) == len(re.findall(rb"/Type /FontDescriptor", data)) > 0
    for number in numbers:
        packed = re.search(rb"\n%s 0 obj\n.*?stream\r?\n(.*?)\r?\nendstream" % number, data, re.DOTALL).group(1)
        font = TTFont(io.BytesIO(zlib.decompress(packed)))
        assert {"glyf", "loca", "head"} <= set(font.keys())


def test_the_svg_needs_no_font():
    """Letters are paths in the SVG: it looks the same where the font is missing."""
    text = encode(learning_curves(*Sweep().frames()), "svg").decode()
    assert text.startswith("<?xml")
    assert "<text" not in text
    assert "DejaVuSans-" in text


def test_the_command_line_knows_widths():
    """`--width` offers what there is."""
    assert set(Across) == set(WIDEST)


@pytest.mark.parametrize("scene", [Sweep().frames, scenes.main_results])
def test_a_column_is_a_column_wide(scene):
    """A figure for a column is 3.3 inches wide whatever it shows, with letters of 5.5 points or more; a page's is at
    most 7 inches.
    """
    column, page = (learning_curves(*scene(), width=width) for width in ("column", "page"))
    assert column.get_figwidth() == 3.3
    assert page.get_figwidth() <= 7
    encode(column, "png")
    shown = [text for text in column.findobj(mpl.text.Text) if text.get_text() and text.get_visible()]
    assert min(text.get_fontsize() for text in shown) >= 5.5


def test_ids_of_an_svg_say_nothing_of_positions():
    """Layout leaves the last bits of a position to chance; ids, which matplotlib makes of it, are counted."""
    files = []
    for left in (0.1, 0.1 + 1e-12):
        figure = Figure(figsize=(2, 2))
        figure.add_axes((left, 0.1, 0.8, 0.8)).plot([0, 1], [0, 1], marker="o")
        files.append(encode(figure, "svg"))
    assert files[0] == files[1]
    names = re.findall(rb'(?:href="#|url\(#)([^")]*)', files[0])
    assert names
    assert all(b'id="' + name + b'"' in files[0] for name in names)
