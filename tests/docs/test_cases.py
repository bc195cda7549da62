#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""docs/cases.md is true: every case it calls covered has a test that CTest runs, that names the
case in the comment above it (or in its first line), and that asks for the sentence; and the sentence
stands in the sources.

    test_cases.py SOURCE_FOLDER BUILD_FOLDER

A row is `| number | what happens | what gieson says | test: function |`. Where a sentence holds a
figure or a name there is an ellipsis in it; the pieces between are what is looked for. A row whose
last column begins with "planned" is not covered. Where all is well in the end a row begins with
"nothing to say:" and its test only names the case."""
import json
import pathlib
import re
import subprocess
import sys

CASES = 68
LEAST_COVERED = 68
# So much of a sentence, in characters, is asked for by its test: no two sentences share it.
SHARED = 12
ROOMS = ("acquire", "pipeline", "storage", "systemd", "ui")


def joined(text):
    """Source text with the literals that follow each other made one, escapes undone."""
    text = re.sub(r'"\s*(?:\\\n\s*)?(?:f)?"', "", text)
    return text.replace('\\"', '"').replace("%%", "%")


def rows_of(page):
    rows = {}
    for line in page.splitlines():
        cells = [cell.strip() for cell in line.strip().strip("|").split("|")]
        if len(cells) == 4 and cells[0].isdigit():
            rows[int(cells[0])] = cells[1:]
    return rows


def pieces_of(sentence):
    quoted = re.findall(r"`([^`]+)`", sentence)
    return [piece.strip() for one in quoted for piece in one.split("…") if len(piece.strip()) > 3]


def function_in(text, name):
    """The comment above a function and its body, up to the next function."""
    found = re.search(rf"^(?:TEST\({name}\)|(?: {{4}})?def {name}\(.*)$", text, re.M)
    if not found:
        return None, None
    above = text[:found.start()].splitlines()[-5:]
    comment = []
    for line in reversed(above):
        if not re.match(r"\s*(/\*|\*|#|@|//| \*)", line):
            break
        comment.insert(0, line)
    below = text[found.end():]
    following = re.search(r"^(?:TEST\(|(?: {4})?def |@scenario)", below, re.M)
    body = below[:following.start() if following else len(below)]
    return "\n".join(comment) + "\n" + "\n".join(body.splitlines()[:3]), body


def names_case(comment, number):
    for said in re.findall(r"Cases?\s+((?:\d+(?:,\s*|\s+and\s+)?)+)|case\s+(\d+)", comment):
        if str(number) in re.findall(r"\d+", " ".join(said)):
            return True
    return False


def check_row(number, row, tests, files, sources):
    sentence, where = row[1], row[2]
    parts = re.fullmatch(r"`([\w.]+): (\w+)`", where)
    pieces = pieces_of(sentence)
    if not parts:
        return "its test is not written as `test: function`"
    if not pieces and not sentence.startswith("nothing to say:"):
        return "no sentence stands in backquotes"
    for piece in pieces:
        if piece not in sources:
            return f"no source says: {piece}"
    if parts[1] not in tests:
        return f"CTest has no test {parts[1]}"
    for path, text in files.items():
        comment, body = function_in(text, parts[2])
        if comment is None:
            continue
        if not names_case(comment, number):
            return f"{path}: {parts[2]} does not name it"
        whole = joined(text)
        windows = {piece[i:i + SHARED] for piece in pieces
                   for i in range(max(1, len(piece) - SHARED + 1))}
        if pieces and not any(window in whole for window in windows):
            return f"{path} does not ask for its sentence"
        return None
    return f"no test file has {parts[2]}"


def main():
    root, build = pathlib.Path(sys.argv[1]), sys.argv[2]
    listed = json.loads(subprocess.run(["ctest", "--show-only=json-v1"], cwd=build, check=True,
                                       capture_output=True, text=True).stdout)
    tests = {test["name"] for test in listed["tests"]}
    files = {str(path.relative_to(root)): path.read_text()
             for path in sorted((root / "tests").rglob("test_*")) if path.suffix in (".c", ".py")}
    sources = "\n".join(joined(path.read_text()) for room in ROOMS
                        for path in sorted((root / room).rglob("*.c")))
    rows = rows_of((root / "docs/cases.md").read_text())
    wrong = [f"case {n} is not in docs/cases.md" for n in range(1, CASES + 1) if n not in rows]
    covered = 0
    for number, row in sorted(rows.items()):
        if row[2].startswith("planned"):
            continue
        covered += 1
        said = check_row(number, row, tests, files, sources)
        if said:
            wrong.append(f"case {number}: {said}")
    if covered < LEAST_COVERED:
        wrong.append(f"only {covered} cases are covered, {LEAST_COVERED} are promised")
    for line in wrong:
        print(line)
    print(f"{covered} of {CASES} cases have a test that asks for their sentence")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
