#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The manual and the programs say the same: pages without a warning, every verb and option that
--help lists, every key of the configuration."""
import re
import shutil
import subprocess
import sys
import tempfile
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


def mistakes(text):
    """What the service says of a configuration."""
    with tempfile.TemporaryDirectory() as there:
        file = Path(there) / "gieson.conf"
        file.write_text(text)
        return said(giesond, "--check-config", "--config", str(file)).stderr


def is_refused(address, keys, key):
    """Whether this kind of source does not know the key; its value may be as wrong as it likes."""
    lines = "".join(f"{name}={value}\n" for name, value in keys.items())
    sentences = mistakes(f"[source a]\nAddress={address}\n{lines}")
    return f'no setting "{key}"' in sentences or "names no source" in sentences


def check_keys():
    """What the program knows is explained, and what is explained it knows."""
    page = roff("gieson.conf.5")
    explained = set()
    for line in re.findall(r"^\.It Va (.*)$", page, re.M):
        explained.update(re.findall(r"[A-Z][A-Za-z]+", line))
    known = set()
    for section in ("store", "work"):
        sentence = mistakes(f"[{section}]\nNosuch=1\n")
        known.update(re.findall(r"[A-Z][A-Za-z]+", sentence.split("it has ")[1]))
    kinds = re.findall(r"([a-z0-9]+):", mistakes("[source a]\nAddress=nosuch:\n").split("give ")[1])
    assert len(known) > 4 and "hot" in kinds, (known, kinds)
    for kind in kinds:
        if not re.search(rf"^\.It Li {kind}:", page, re.M):
            wrong.append(f"sources of kind {kind} are not in gieson.conf.5")
    for key in known - explained:
        wrong.append(f"{key} is not in gieson.conf.5")
    for key in sorted(explained - known - {"Address"}):
        camera = {"Format": "YUYV", "Width": "640", "Height": "480"} | {key: "1"}
        sections = ("hot:/srv", {key: "1"}), ("ptp:any", {key: "1"}), ("v4l2:any", camera)
        if all(is_refused(address, keys, key) for address, keys in sections):
            wrong.append(f"gieson.conf.5 explains {key}, which giesond does not know")


def in_one_line(text):
    return " ".join(text.split())


def check_library():
    """Every function of gieson-spline.h is in the synopsis of one page, as it is declared, and that page's
    name or an alias of it; every member of its structures is explained."""
    header = re.sub(r"/\*.*?\*/", "", (sources / "pipeline/library/gieson-spline.h").read_text(), flags=re.S)
    declared = {name: in_one_line(takes) for name, takes in
                re.findall(r"\b(gsn_\w+)\(([^;{]*?)\)(?:\)\[3\])?;", header, re.S)}
    told, explained, named = {}, set(), set()
    for page in sorted(folder.glob("*.3")):
        text = page.read_text()
        named.update(re.findall(r"^\.Nm (gsn_\w+)", text, re.M))
        for name, takes in re.findall(r"^\.Fo (\w+)\n((?:\.Fa .*\n)*)\.Fc$", text, re.M):
            told[name] = ", ".join(re.findall(r'^\.Fa "(.*)"$', takes, re.M))
        for line in re.findall(r"^\.It Va (.*)$", text, re.M):
            explained.update(re.findall(r"\w+", line))
    assert len(declared) > 20, declared
    for name in sorted(declared.keys() ^ told.keys()):
        wrong.append(f"{name}: only {'gieson-spline.h' if name in declared else 'a page'} knows it")
    for name in sorted(declared.keys() & told.keys()):
        if declared[name] != told[name]:
            wrong.append(f"{name} takes ({declared[name]}), its page says ({told[name]})")
    for name in sorted(declared.keys() ^ named):
        wrong.append(f"{name}: no page has that name, or no function")
    members = set()
    for body in re.findall(r"^struct gsn_\w+ \{(.*?)^\};", header, re.S | re.M):
        for line in re.findall(r"([^;]+);", body):
            members.update(re.findall(r"(\w+)\)?(?:\[\d\])?(?=,|$)", in_one_line(line)))
    for member in sorted(members - explained):
        wrong.append(f"the member {member} is on no page")


check_pages()
check_library()
check_keys()
check_verbs()
check_options()
check_example()
print("\n".join(wrong))
sys.exit(1 if wrong else 0)
