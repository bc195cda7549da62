#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Retired words of docs/GLOSSARY.md are in no file name and in no public identifier.

    test_glossary.py ROOT              exit 1 with a line for each that is
    test_glossary.py ROOT --count      how often each retired word is used, those still in use too

A public identifier is a function, a struct, an enum or a union named gsn_* that a header declares. It is
taken apart at its underscores; a part that equals a retired word is a finding. Words behind which
folders stand are retired in these alone. Two tables of the glossary soften that: "Still allowed" names
identifiers and files (patterns with *) in which a word has another, ordinary sense; "Still in use" names
words that have not been replaced yet."""
import collections
import fnmatch
import pathlib
import re
import sys

FOLDERS = ("acquire", "pipeline", "storage", "ui", "systemd")
SOURCES = (".c", ".h", ".cpp", ".hpp", ".py")
FUNCTION = re.compile(r"\b(gsn_\w+)\)?\(")
TYPE = re.compile(r"\b(?:struct|enum|union) (gsn_\w+) (?=\{)")
FIRST_CELLS = ("term", "name", "word")


def rows_of(page):
    """(section, cells) of every row of a table but its heading."""
    section = ""
    for line in page.splitlines():
        if line.startswith("## "):
            section = line[3:]
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("|") and not set(line) <= set("|-: ") and cells[0] not in FIRST_CELLS:
            yield section, cells


def read_glossary(page):
    """{word: folders in which it is retired, empty for all}, allowed patterns, words still in use"""
    retired, allowed, used = {}, [], set()
    for section, cells in rows_of(page):
        if section == "Still allowed":
            allowed += re.findall(r"`([^`]+)`", cells[0])
        elif section == "Still in use":
            used.update(re.findall(r"`([^`]+)`", cells[0]))
        elif len(cells) == 4:
            for word, folders in re.findall(r"`(\w+)`(?: \(((?:`[^`]+`(?:, )?)+)\))?", cells[3]):
                retired[word] = tuple(re.findall(r"`([^`]+)`", folders))
    return retired, allowed, used


def public_names(text):
    code = re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.S)
    return set(FUNCTION.findall(code)) | set(TYPE.findall(code))


def retired_in(name, where, retired, allowed):
    """The retired words of a name that stands in this file."""
    for word in set(re.split(r"[_.]", name.lower())):
        folders = retired.get(word)
        inside = folders is not None and \
            (not folders or where.startswith(tuple(folder + "/" for folder in folders)))
        if inside and not any(fnmatch.fnmatch(name, p) or fnmatch.fnmatch(where, p) for p in allowed):
            yield word


def findings(root, retired, allowed):
    """(word, name, where) of every use of a retired word."""
    found = set()
    for folder in FOLDERS:
        for file in (root / folder).rglob("*"):
            where = file.relative_to(root).as_posix()
            names = {file.name} if file.suffix in SOURCES else set()
            if file.suffix == ".h":
                names |= {name.removeprefix("gsn_")
                          for name in public_names(file.read_text(encoding="utf-8"))}
            found |= {(word, name, where) for name in names
                      for word in retired_in(name, where, retired, allowed)}
    return sorted(found)


def notices_itself(retired, used):
    """Planted names are found, and others are not."""
    word = next(w for w in sorted(retired) if not retired[w] and w not in used)
    scoped = next(w for w in sorted(retired) if retired[w])
    inside = retired[scoped][0] + "/x.h"
    return list(retired_in(f"a_{word}_b", "ui/x.h", retired, [])) == [word] and \
        list(retired_in(f"{word}.c", "ui/x.c", retired, [])) == [word] and \
        not list(retired_in(f"a{word}b", "ui/x.h", retired, [])) and \
        list(retired_in(scoped, inside, retired, [])) == [scoped] and \
        not list(retired_in(scoped, "nowhere/x.h", retired, [])) and \
        not list(retired_in(f"a_{word}", "ui/x.h", retired, ["a_*"]))


def main():
    root = pathlib.Path(sys.argv[1])
    retired, allowed, used = read_glossary((root / "docs/GLOSSARY.md").read_text(encoding="utf-8"))
    found = findings(root, retired, allowed)
    count = collections.Counter(word for word, _, _ in found)
    if "--count" in sys.argv[2:]:
        for word, uses in count.most_common():
            print(f"{uses:4} {word}: " + ", ".join(sorted({n for w, n, _ in found if w == word})[:9]))
        return 0
    wrong = [f"{where}: {name}: \"{word}\" is retired, see docs/GLOSSARY.md"
             for word, name, where in found if word not in used]
    wrong += [f"docs/GLOSSARY.md: {word} is still in use, and not retired" for word in used - set(retired)]
    if len(retired) < 60 or not notices_itself(retired, used):
        wrong.append("the test does not notice what it should")
    print("\n".join(wrong + [f"{len(retired)} words are retired; {len(used)} are still in use, in "
                             f"{sum(count[word] for word in used)} names"]))
    for word in sorted(used - set(count)):
        print(f"{word} is in use no more: take it out of the table")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
