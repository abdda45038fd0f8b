"""Reading a picture by its artists."""

import itertools

import matplotlib as mpl
from matplotlib.backends.backend_agg import FigureCanvasAgg

from rrmctl.reports.styles import style


def panels(figure):
    return [axes for axes in figure.findobj(mpl.axes.Axes) if axes.get_visible()]


def legend(figure):
    return [text.get_text() for found in figure.findobj(mpl.legend.Legend) for text in found.get_texts()]


def words(figure):
    """All text, lines joined."""
    return " ".join(text.get_text() for text in figure.findobj(mpl.text.Text)).replace("\n", " ")


def lines(axes, method):
    """The lines of a method's colour with more than one point and a line style."""
    return [
        line
        for line in axes.get_lines()
        if line.get_color() == style(method).color and len(line.get_xdata()) > 1 and line.get_linestyle() != "None"
    ]


def misplaced(figure):
    """Titles, names of axes, notes and entries of the legend that reach over the page's edge, or over each other."""
    figure.set_dpi(200)  # as in the file: letters of few pixels are wider
    FigureCanvasAgg(figure).draw()  # lays it out
    named = [text for axes in panels(figure) for text in (axes.title, axes.xaxis.label, axes.yaxis.label)]
    loose = [text for part in figure.findobj(mpl.figure.FigureBase) for text in part.texts]
    entries = [text for found in figure.findobj(mpl.legend.Legend) for text in found.get_texts()]
    shown = [text for text in (*named, *loose, *entries, *_headings(figure)) if text.get_text()]
    boxes = {text: text.get_window_extent() for text in shown}
    page = figure.bbox.padded(1)
    beyond = [text.get_text() for text, box in boxes.items() if not _within(box, page)]
    pairs = itertools.combinations(boxes.items(), 2)
    return beyond + [f"{a.get_text()} / {b.get_text()}" for (a, one), (b, two) in pairs if one.padded(-1).overlaps(two)]


def _headings(figure):
    return [part._suptitle for part in figure.findobj(mpl.figure.FigureBase) if part._suptitle is not None]


def _within(box, page):
    return page.x0 <= box.x0 and box.x1 <= page.x1 and page.y0 <= box.y0 and box.y1 <= page.y1
