#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Every link of every page leads somewhere: to a file, and to a heading of it where one is named.
Pages that are installed together link to nothing outside of their folder.

    test_links.py FOLDER          the pages below FOLDER, which may not lead out of it
    test_links.py FOLDER PAGE...  these pages too, which may lead anywhere that is there
"""
import pathlib
import re
import sys

LINK = re.compile(r"\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```.*?^```[ ]*$", re.S | re.M)


def anchors_of(page):
    """The headings of a page as links name them."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
            for heading in re.findall(r"^#+ +(.+?) *$", text, re.M)}


def wrong_links(page, within):
    for target in LINK.findall(FENCE.sub("", page.read_text(encoding="utf-8"))):
        if "://" in target:
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        if not file.exists():
            yield f"{page}: the link to {target} leads nowhere"
        elif within and within not in [file, *file.parents]:
            yield f"{page}: the link to {target} leads out of what is installed"
        elif anchor and anchor not in anchors_of(file):
            yield f"{page}: the link to {target} leads to no heading of that page"


def unreached(folder):
    """Pages that nobody comes to who begins at a README of theirs or of a folder above."""
    pages = {page.resolve() for page in folder.rglob("*.md")}
    seen, new = set(), [page for page in pages if page.name in ("README.md", "ARCHITECTURE.md")]
    while new:
        page = new.pop()
        if page in seen:
            continue
        seen.add(page)
        for target in LINK.findall(page.read_text(encoding="utf-8")):
            file = (page.parent / target.partition("#")[0]).resolve()
            if file in pages:
                new.append(file)
    return sorted(pages - seen)


def main():
    folder = pathlib.Path(sys.argv[1]).resolve()
    pages = sorted(folder.rglob("*.md"))
    wrong = [line for page in pages for line in wrong_links(page, folder)]
    for page in sys.argv[2:]:
        wrong += wrong_links(pathlib.Path(page).resolve(), None)
    wrong += [f"{page}: no page links to it" for page in unreached(folder)]
    print("\n".join(wrong) if wrong else f"{len(pages)} pages, all links lead somewhere")
    return 1 if wrong or not pages else 0


if __name__ == "__main__":
    sys.exit(main())
