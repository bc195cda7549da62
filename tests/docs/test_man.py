#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The manual and the programs say the same: pages without a warning, every verb and option that
--help lists, every key of the configuration."""
import re
import shutil
import subprocess
import sys
from pathlib import Path

sources, gieson, giesond = Path(sys.argv[1]), sys.argv[2], sys.argv[3]
folder = sources / "docs/man"
wrong = []


def said(*command):
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)


def check_pages():
    if not shutil.which("man"):
        print("skipped: man is not installed")
        sys.exit(77)
    pages = sorted(folder.glob("*.[1-8]"))
    assert len(pages) >= 3, pages
    for page in pages:
        shown = said("man", "--warnings", "-E", "UTF-8", "-l", "-Tutf8", "-Z", str(page))
        if shown.stderr or shown.returncode:
            wrong.append(f"{page.name}: {shown.stderr.strip()}")


def roff(page):
    """A page's text as a reader sees words, with its list items one a line."""
    return (folder / page).read_text().replace("\\-", "-").replace("Fl -", "--").replace(" , ", " ")


def check_verbs():
    page = roff("gieson.1")
    listed = said(gieson, "--help").stdout.split("Verbs:")[1]
    verbs = set(re.findall(r"^  ([a-z][a-z-]*)", listed, re.M))
    told = set(re.findall(r"^\.It Cm ([a-z][a-z-]*)", page, re.M))
    assert len(verbs) > 5
    for verb in verbs ^ told:
        wrong.append(f"gieson {verb}: only {'--help' if verb in verbs else 'gieson.1'} knows it")


def check_options():
    page = roff("giesond.8")
    for option in re.findall(r"(--[a-z-]+)", said(giesond, "--help").stdout):
        if option not in page and option not in ("--help", "--usage", "--version"):
            wrong.append(f"giesond {option} is not in giesond.8")


def check_example():
    """Every key that the installed example shows is explained, with the same default."""
    page = roff("gieson.conf.5")
    keys = re.findall(r"^#?([A-Z][A-Za-z]+)=(.*)$", (sources / "systemd/gieson.conf").read_text(), re.M)
    assert len(keys) > 5
    for key, value in keys:
        item = re.search(rf"^\.It Va .*\b{key}\b.*\n((?:(?!^\.It Va).*\n)*)", page, re.M)
        if not item:
            wrong.append(f"{key} of gieson.conf is not in gieson.conf.5")
        elif key != "Address" and value not in item.group(1):
            wrong.append(f"{key}: gieson.conf.5 does not say {value}")


check_pages()
check_verbs()
check_options()
check_example()
print("\n".join(wrong))
sys.exit(1 if wrong else 0)
