#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""What docs/MATH.md and docs/ARCHITECTURE.md name exists: functions, tests, equations (1) to (10).

    test_math_table.py ROOT

A function is any `gsn_...` in backquotes and must be declared in a header. A test is written
"folder/file: `name`, `name`" and must be TEST(name) in tests/folder/test_file.c. Every row of a
table whose heading has the columns "function" and "test" must name one of each. The checker then
spoils the text in every way it knows and demands of itself that it notices.
"""
import pathlib
import re
import sys

FUNCTION = re.compile(r"\bgsn_[a-z0-9_]+")
QUOTED = re.compile(r"`([^`]+)`")
TEST_LIST = re.compile(r"(\w+(?:/\w+)+): ((?:`[a-z0-9_]+`(?:, )?)+)")
LOOKS_LIKE_A_TEST = re.compile(r"^[a-z0-9]+(?:_[a-z0-9]+){3,}$")


def declared(root):
    """Every name that a header declares as a function."""
    names = set()
    for room in ("pipeline", "acquire", "storage", "ui", "systemd"):
        for header in (root / room).rglob("*.h"):
            code = re.sub(r"/\*.*?\*/", "", header.read_text(encoding="utf-8"), flags=re.S)
            names.update(re.findall(r"\b(gsn_\w+)\)?\(", code))
    return names


def tests_of(root, place):
    folder, file = place.rsplit("/", 1)
    path = root / "tests" / folder / f"test_{file}.c"
    if not path.is_file():
        return None
    return set(re.findall(r"^TEST\((\w+)\)", path.read_text(encoding="utf-8"), re.M))


def check_functions(text, functions):
    for quoted in QUOTED.findall(text):
        for name in FUNCTION.findall(quoted):
            if name not in functions:
                yield f"no header declares {name}"


def check_tests(text, root):
    placed = set()
    for place, names in TEST_LIST.findall(text):
        known = tests_of(root, place)
        if known is None:
            yield f"there is no file for the tests of {place}"
            continue
        for name in QUOTED.findall(names):
            placed.add(name)
            if name not in known:
                yield f"{place} has no TEST({name})"
    for name in QUOTED.findall(text):
        if LOOKS_LIKE_A_TEST.match(name) and not name.startswith("gsn_") and name not in placed:
            yield f"{name} is named without its file"


def rows(text):
    """(columns by heading, line) of every row below a heading with "function" and "test"."""
    heading = None
    for line in text.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if not line.startswith("|"):
            heading = None
        elif heading is None:
            heading = cells
        elif {"function", "test"} <= set(heading) and not set(line) <= set("|-: "):
            yield dict(zip(heading, cells)), line


def check_rows(text):
    equations = set()
    for row, line in rows(text):
        start = line[:40]
        if not FUNCTION.search(row.get("function", "")):
            yield f"this row names no function: {start}"
        if not TEST_LIST.search(row.get("test", "")):
            yield f"this row names no test: {start}"
        equations.update(int(n) for n in re.findall(r"\((\d+)\)", row.get("equation", "")))
    for missing in sorted(set(range(1, 11)) - equations):
        yield f"equation ({missing}) has no row"


def complaints(math, architecture, root, functions):
    yield from check_functions(math, functions)
    yield from check_functions(architecture, functions)
    yield from check_tests(math, root)
    yield from check_tests(architecture, root)
    yield from check_rows(math)


def spoilt(math):
    """The same text with one falsehood each."""
    function = re.search(r"`gsn_\w+`", math).group(0)
    place, names = TEST_LIST.search(math).groups()
    name = QUOTED.search(names).group(0)
    table = next(line for _, line in rows(math))
    cells = table.split("|")
    yield "a function that is not there", math.replace(function, "`gsn_is_not_there`", 1)
    yield "a test that is not there", math.replace(name, "`this_is_no_true_sentence`", 1)
    yield "a file that is not there", math.replace(f"{place}:", f"{place}x:", 1)
    yield "a test without its file", math + "\n`this_is_no_true_sentence`\n"
    yield "a row without a function", math.replace(table, "|".join([*cells[:2], " - ", *cells[3:]]))
    yield "a row without a test", math.replace(table, "|".join([*cells[:3], " - ", *cells[4:]]))
    yield "an equation without a row", math.replace(table + "\n", "")


def main():
    root = pathlib.Path(sys.argv[1])
    math = (root / "docs" / "MATH.md").read_text(encoding="utf-8")
    architecture = (root / "docs" / "ARCHITECTURE.md").read_text(encoding="utf-8")
    functions = declared(root)
    found = list(complaints(math, architecture, root, functions))
    for sentence in found:
        print(sentence)
    missed = 0
    for what, text in spoilt(math):
        if len(list(complaints(text, architecture, root, functions))) <= len(found):
            print(f"planted {what}: not noticed")
            missed += 1
    named = set(FUNCTION.findall(math)), {n for _, names in TEST_LIST.findall(math)
                                          for n in QUOTED.findall(names)}
    print(f"{len(named[0])} functions and {len(named[1])} tests are named")
    return 1 if found or missed else 0


if __name__ == "__main__":
    sys.exit(main())
