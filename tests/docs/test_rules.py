#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""docs/RULES.md and the sources say the same of every constant that decides something.

    test_rules.py ROOT

Below a heading the first code span of a paragraph that ends in / is the folder of its tables. A row names
files of that folder and constants with their values; each constant is in one of these files with that
value, and the row says what needs it and where it was seen to help. The table at the end names the
constants that decide nothing, by path. Every threshold of these folders is in one of both: any named
constant that is not whole by its type, and any whole one named LEAST, FEWEST, MOST, MIN or MAX.
The checker then spoils page and sources in every way it knows and demands of itself that it notices."""
import pathlib
import re
import sys

SCOPE = ("pipeline/register", "pipeline/stain", "pipeline/specimen", "pipeline/measure/tissue_volume.c",
         "pipeline/measure/loss.c", "pipeline/measure/base_cells.c")
WHOLE = re.compile(r"(?:^|_)(?:LEAST|FEWEST|MOST|MIN|MAX)(?:_|$)")
COMMENT = re.compile(r"/\*.*?\*/|//[^\n]*", re.S)
DEFINE = re.compile(r"^\s*#define\s+([A-Z]\w+)[ \t]+(\S.*?)[ \t]*$", re.M)
CONST = re.compile(r"^(?:static\s+)?const\s+(double|float|int|size_t|uint\w+|unsigned)\s+([^;()]*?=[^;]*);", re.M)
ENUM = re.compile(r"^enum\s*\w*\s*\{([^}]*)\}", re.M)
CASES = 68


def parted(text):
    """At commas outside of brackets."""
    depth, part = 0, ""
    for letter in text + ",":
        depth += (letter in "({") - (letter in ")}")
        if letter == "," and depth == 0:
            yield part
            part = ""
        else:
            part += letter


def constants_of(text):
    """{name: (value, whether it is whole by its type)}"""
    code = COMMENT.sub("", text)
    found = {name: (value, False) for name, value in DEFINE.findall(code) if re.search(r"\d", value)}
    for kind, body in CONST.findall(code):
        for part in parted(body):
            name, _, value = part.partition("=")
            found[re.sub(r"\[.*?\]", "", name).strip()] = (" ".join(value.split()),
                                                           kind not in ("double", "float"))
    for body in ENUM.findall(code):
        for part in parted(body):
            name, equals, value = part.partition("=")
            if equals:
                found[name.strip()] = (" ".join(value.split()), True)
    return found


def sources(root):
    """{path: its constants}"""
    files = [root / place for place in SCOPE if (root / place).is_file()]
    for place in SCOPE:
        files += sorted((root / place).rglob("*.[ch]"))
    return {file.relative_to(root).as_posix(): constants_of(file.read_text(encoding="utf-8"))
            for file in files}


def rows_of(page):
    """(folder of the tables, {heading: cell}) of every row."""
    folder, heading = "", None
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if line.startswith("## "):
            folder = ""
        if not line.startswith("|"):
            heading = None
            place = re.match(r"`(\S+/)`", line)
            folder = place.group(1) if place else folder
        elif heading is None:
            heading = cells
        elif not set(line) <= set("|-: "):
            yield folder, dict(zip(heading, cells)), len(cells) == len(heading)


def check_row(folder, row, files, told):
    name = row["rule"]
    paths = [folder + file.strip() for file in row["file"].split(",")]
    for path in paths:
        if path not in files:
            yield f"{name}: {path} is none of the files that this page is about"
    named = re.findall(r"`(\w+) = ([^`]+)`", row["constants"])
    if not named or len(named) * 2 != row["constants"].count("`"):
        yield f"{name}: a constant is not written as `NAME = value`"
    for constant, value in named:
        having = [path for path in paths if constant in files.get(path, {})]
        if not having:
            yield f"{name}: {constant} is in none of {', '.join(paths)}"
        for path in having:
            told.add((path, constant))
            if files[path][constant][0] != value:
                yield f"{name}: {constant} is {files[path][constant][0]} in {path} and {value} on the page"
    for case in re.findall(r"\d+", row["case"]):
        if not 1 <= int(case) <= CASES:
            yield f"{name}: there is no case {case}"
    if not (row["case"] == "-" or re.fullmatch(r"\d+(, \d+)*", row["case"])):
        yield f"{name}: cases are numbers, or a dash"
    if not row["method"] or not row["seen to help on"]:
        yield f"{name}: it lacks its method, or where it was seen to help"


def complaints(page, files):
    told, rules = set(), 0
    for folder, row, whole in rows_of(page):
        if not whole:
            yield f"a row has another number of cells than its heading: {list(row.values())[0]}"
        elif "rule" in row:
            rules += 1
            yield from check_row(folder, row, files, told)
        elif set(row) == {"file", "constants"}:
            for constant in re.findall(r"`(\w+)`", row["constants"]):
                if constant not in files.get(row["file"], {}):
                    yield f"{constant} is not in {row['file']}"
                elif (row["file"], constant) in told:
                    yield f"{constant} of {row['file']} decides something and nothing"
                told.add((row["file"], constant))
    if rules < 50:
        yield "the page has lost its rules"
    for path, constants in files.items():
        for name, (value, whole) in constants.items():
            if (path, name) not in told and (not whole or WHOLE.search(name)):
                yield f"{path}: {name} = {value} has no row in docs/RULES.md"


def spoilt(page, files):
    """Page and sources with one falsehood each."""
    row = next(row for _, row, _ in rows_of(page) if "rule" in row)
    name, value = re.search(r"`(\w+) = ([^`]+)`", row["constants"]).groups()
    path = next(path for path in files if path.endswith("/" + row["file"]))
    line = next(line for line in page.splitlines() if line.startswith(f"| {row['rule']} "))
    yield "another value on the page", page.replace(f"`{name} = {value}`", f"`{name} = 1{value}`", 1), files
    yield "another value in the source", page, {**files, path: {**files[path], name: ("17", False)}}
    yield "a constant that went", page, {**files, path: {n: v for n, v in files[path].items() if n != name}}
    yield "a constant that came", page, {**files, path: {**files[path], "NOBODY_KNOWS": ("0.5", False)}}
    yield "a least number that came", page, {**files, path: {**files[path], "LEAST_OF_ALL": ("5", True)}}
    yield "a file that went", page, {p: c for p, c in files.items() if p != path}
    yield "a row that went", page.replace(line + "\n", ""), files
    yield "a case that is not there", page.replace(line, line.replace(f"| {row['case']} |", "| 69 |")), files
    yield "no witness", page.replace(line, line.replace(row["seen to help on"], "")), files


def main():
    root = pathlib.Path(sys.argv[1])
    page = (root / "docs" / "RULES.md").read_text(encoding="utf-8")
    files = sources(root)
    found = list(complaints(page, files))
    print("\n".join(found))
    missed = [what for what, text, code in spoilt(page, files)
              if len(list(complaints(text, code))) <= len(found)]
    for what in missed:
        print(f"planted: {what}; not noticed")
    rows = [row for _, row, _ in rows_of(page) if "rule" in row]
    alone = sum(row["seen to help on"].startswith("**") for row in rows)
    print(f"{len(rows)} rules with {sum(row['constants'].count('=') for row in rows)} constants; {alone} rules were "
          "seen on nothing but our own drawings, or not at all")
    return 1 if found or missed else 0


if __name__ == "__main__":
    sys.exit(main())
