#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The user's manual says what the programs do.

    test_user.py ROOT GIESON

- remedies.md has each of the 68 faults of cases.md, and every sentence in it stands in the sources.
- reference.md has every verb that --help lists, with an example, and every exit status of gieson.1.
- job.md and gieson-job.5 have the keys that the program knows, and no others.
- No sentence of the programs names a file of the repository's docs: who installed the package may
  not have it there. man pages are named instead, and each that is named exists.
"""
import pathlib
import re
import subprocess
import sys

CASES = 68
FOLDERS = ("acquire", "pipeline", "storage", "systemd", "ui")
SHORTEST_PIECE = 4

root, gieson = pathlib.Path(sys.argv[1]), sys.argv[2]
user = root / "docs/user"
wrong = []


def join_literals(text):
    """Source text with the literals that follow each other made one, escapes undone."""
    text = re.sub(r'"\s*(?:\\\n\s*)?(?:f)?"', "", text)
    return text.replace('\\"', '"').replace("%%", "%")


sources = {path: path.read_text(encoding="utf-8") for folder in FOLDERS
           for path in sorted((root / folder).rglob("*.[ch]"))}
said = "\n".join(join_literals(text) for text in sources.values())


def check_remedies():
    page = (user / "remedies.md").read_text(encoding="utf-8")
    items = re.findall(r"^- (.+(?:\n  .+)*)", page, re.M)
    numbers = [int(n) for group in re.findall(r"\((\d+(?:, \d+)*)\)$", "\n".join(items), re.M)
               for n in group.split(", ")]
    for case in range(1, CASES + 1):
        if case not in numbers:
            wrong.append(f"remedies.md has no remedy for case {case}")
    count = 0
    for item in items:
        sentence = re.match(r"`([^`]+)`<br>\n  \S", item)
        if not sentence:
            continue
        count += 1
        for piece in sentence.group(1).split("…"):
            # A printed figure may stand for a format's %d, %.1f and so on.
            if len(piece.strip()) >= SHORTEST_PIECE and piece.strip() not in said:
                wrong.append(f"remedies.md: no source says: {piece.strip()}")
    if count < CASES - 15:
        wrong.append(f"remedies.md: only {count} sentences were found")


def check_reference():
    page = (user / "reference.md").read_text(encoding="utf-8")
    shown = subprocess.run([gieson, "--help"], capture_output=True, text=True, check=True).stdout
    verbs = set(re.findall(r"^  ([a-z][a-z-]*)", shown.split("Verbs:")[1], re.M))
    blocks = "\n".join(re.findall(r"^```sh.*?\n(.*?)^```", page, re.S | re.M))
    typed = set(re.findall(r"^gieson ([a-z][a-z-]*)", blocks, re.M))
    for verb in sorted(verbs ^ typed):
        wrong.append(f"reference.md: {verb} " + ("has no example" if verb in verbs else "is no verb"))
    manual = (root / "docs/man/gieson.1").read_text(encoding="utf-8").split(".Sh EXIT STATUS")[1]
    for status in re.findall(r"^\.It (\d+)$", manual, re.M):
        if not re.search(rf"^\| {status} \|", page, re.M):
            wrong.append(f"reference.md does not have the exit status {status}")


def check_keys():
    tables = [set(re.findall(r'"([a-z_]+)"', table)) for text in sources.values()
              for table in re.findall(r"static const char \*const \w+\[\] = \{([^}]*)\}", text)]
    known = next((table for table in tables if {"markers_um", "collagen_free"} <= table), None)
    assert known and len(known) > 30, known
    rows = re.findall(r"^\| (`[^|]+) \|", (user / "job.md").read_text(encoding="utf-8"), re.M)
    page = {key for row in rows for key in re.findall(r"`([a-z_]+)(?:\.\.\.)?`", row)}
    manual = (root / "docs/man/gieson-job.5").read_text(encoding="utf-8")
    items = {key for line in re.findall(r"^\.It Va (.*)$", manual, re.M)
             for key in re.findall(r"[a-z_]+", line)}
    for where, told in (("docs/user/job.md", page), ("docs/man/gieson-job.5", items)):
        for key in sorted(known ^ told):
            wrong.append(f"{where}: {key} " + ("is missing" if key in known else "is no key"))


def check_messages():
    for path, text in sources.items():
        code = re.sub(r"/\*.*?\*/", "", text, flags=re.S)
        for literal in re.findall(r'"((?:\\.|[^"\\\n])*)"', code):
            if re.search(r"\bdocs/|\.md\b", literal):
                wrong.append(f"{path.relative_to(root)} names a file of docs: {literal}")
            for page in re.findall(r"\bman ([a-z][a-z.-]*[a-z])", literal):
                if not list((root / "docs/man").glob(f"{page}.[1-8]")):
                    wrong.append(f"{path.relative_to(root)} names the page {page}, which is not there")


check_remedies()
check_reference()
check_keys()
check_messages()
print("\n".join(wrong) if wrong else "the manual says what the programs do")
sys.exit(1 if wrong else 0)
