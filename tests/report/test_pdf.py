#!/usr/bin/python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The report on paper: everything that the page says stands in it, and nothing lies beyond the sheet.

    test_pdf.py REPORT_SAMPLE     exit 77 (skipped) without poppler-utils

REPORT_SAMPLE writes made-up pages of each kind as HTML and as PDF (report_sample.c). What they say
is read by poppler and by Python's own HTML parser."""
import html.parser
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

# What paper cannot do (pdf.c), and what is no text.
LEFT_OUT_IDS = {"charts", "model"}
LEFT_OUT = {"head", "nav", "svg", "script", "canvas"}
VOID = {"img", "meta", "br", "input"}
EDGE = 36  # points; nothing is printed nearer to the edge of the sheet


class Page(html.parser.HTMLParser):
    """The words that a reader of the page sees, and how many pictures."""

    def __init__(self):
        super().__init__()
        self.words, self.pictures, self.open = [], 0, []

    def left_out(self):
        return any(out for _, out in self.open)

    def handle_starttag(self, tag, attrs):
        attrs = dict(attrs)
        out = tag in LEFT_OUT or attrs.get("id") in LEFT_OUT_IDS
        if tag == "img" and not self.left_out():
            self.pictures += 1
        if tag not in VOID:
            self.open.append((tag, out))

    def handle_endtag(self, tag):
        while self.open and self.open.pop()[0] != tag:
            pass

    def handle_data(self, data):
        if not self.left_out():
            self.words += data.split()


def run(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def bare(text):
    """Without white space and without the marks of a list: lines are broken elsewhere on paper."""
    return re.sub(r"[\s\u2022\u00ad]+", "", text)


def check_kind(folder, name):
    page = Page()
    page.feed((folder / f"{name}.html").read_text(encoding="utf-8"))
    pdf = folder / f"{name}.pdf"
    told = run("pdftotext", "-raw", str(pdf), "-")
    # Words may be broken at the end of a line, and cells of a table stand between: word by word.
    paper = bare(told)
    lost = sorted({w for w in page.words if bare(w) not in paper})
    assert not lost, f"{name}: on the page and not on paper: {lost[:20]}"
    numbers = [w for w in page.words if re.search(r"\d", w)]
    assert len(numbers) > 20, f"{name}: {len(numbers)} numbers"
    shown = [line for line in run("pdfimages", "-list", str(pdf)).splitlines()[2:]
             if " image " in line]
    assert len(shown) >= 1 and len(shown) <= page.pictures, f"{name}: {len(shown)} pictures"
    sheets = re.findall(r'<page width="([\d.]+)" height="([\d.]+)">(.*?)</page>',
                        run("pdftotext", "-bbox", str(pdf), "-"), re.S)
    for number, (width, height, words) in enumerate(sheets, 1):
        assert (round(float(width)), round(float(height))) == (595, 842), (width, height)
        boxes = re.findall(r'<word xMin="(.*?)" yMin="(.*?)" xMax="(.*?)" yMax="(.*?)">(.*?)<', words)
        for x0, y0, x1, y1, word in boxes:
            assert float(x0) >= EDGE and float(x1) <= float(width) - EDGE and float(y0) >= EDGE and \
                float(y1) <= float(height) - 24, f"{name}, page {number}: {word} at the edge"
        assert f"Page {number}" in run("pdftotext", "-f", str(number), "-l", str(number), str(pdf), "-")
    assert "CreationDate" not in run("pdfinfo", str(pdf)), "a date"


def main():
    if not shutil.which("pdftotext"):
        print("SKIPPED: poppler-utils is not there")
        return 77
    with tempfile.TemporaryDirectory() as first, tempfile.TemporaryDirectory() as second:
        for folder in (first, second):
            run(sys.argv[1], folder)
        for name in ("specimen", "withheld", "volume", "tile"):
            check_kind(pathlib.Path(first), name)
            assert (pathlib.Path(first) / f"{name}.pdf").read_bytes() == \
                (pathlib.Path(second) / f"{name}.pdf").read_bytes(), f"{name}: other bytes"
    print("the paper says what the page says")
    return 0


if __name__ == "__main__":
    sys.exit(main())
