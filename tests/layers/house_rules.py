#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""The rules of the house that a compiler does not know: who may include whom, which calls have one
door only, that no failure is dropped, that every source opens with what it does, and that no line is
longer than a screen shows.

    house_rules.py ROOT              checks the tree; prints "file:line: sentence", exit 1 if any
    house_rules.py ROOT --self-test  plants one violation of each rule in a copy and demands that
                                     each is found
"""
import pathlib
import re
import shutil
import sys
import tempfile

WIDEST = 100
ROOMS = ("acquire", "pipeline", "storage", "ui", "systemd", "udev")

# folder -> folders whose headers it may include (its own always). The longest match counts.
LAYERS = {
    "pipeline/core": (),
    "acquire": ("pipeline/core",),
    "storage": ("pipeline/core",),
    "pipeline/decode": ("pipeline/core",),
    "pipeline/imaging": ("pipeline/core",),
    "pipeline/register": ("pipeline/core", "pipeline/imaging"),
    "pipeline/stain": ("pipeline/core", "pipeline/imaging"),
    "pipeline/model": ("pipeline/core",),
    "pipeline/measure": ("pipeline/core", "pipeline/model"),
    "pipeline/render": ("pipeline/core", "pipeline/model"),
    "pipeline/export": ("pipeline/core", "pipeline/model", "pipeline/measure", "pipeline/render"),
    "pipeline/library": ("pipeline/core", "pipeline/model", "pipeline/measure", "pipeline/render",
                         "pipeline/export"),
    "pipeline/report": ("pipeline/core", "pipeline/measure", "pipeline/render"),
    "pipeline/phantom": ("pipeline/core", "pipeline/decode"),
    "pipeline/study": ("pipeline/core", "pipeline/measure", "pipeline/report"),
    "pipeline/folder": ("pipeline/core", "pipeline/decode", "pipeline/register"),
    "pipeline/specimen": ("pipeline",),
    "ui": ("pipeline/core", "storage"),
    "systemd": ("pipeline", "acquire", "storage"),
}

# foreign header -> the only files that may name it
FOREIGN = {
    r"sqlite3\.h": r"^storage/",
    r"opencv2/.*": r"^pipeline/imaging/",
    r"zip\.h": r"^pipeline/specimen/imagej_roi\.c$",
    r"dmtx\.h": r"^pipeline/(decode/codes|phantom/label)\.c$",
    r"zbar\.h": r"^pipeline/decode/codes\.c$",
    r"gsl/.*": r"^pipeline/core/(linalg|robust|distributions|gsl_door)\.c$",
    r"tetgen\.h": r"^pipeline/model/tetgen_bridge\.cpp$",
    r"(cairo|pango|fontconfig)/.*": r"^pipeline/render/",
    r"hdf5\.h": r"^pipeline/model/model_file\.c$",
    r"(tiffio|jpeglib|png)\.h": r"^pipeline/(decode|export|phantom)/",
    r"(zlib|openslide/.*|lcms2)\.h": r"^pipeline/(decode|export)/",
    r"libcamera/.*": r"^acquire/libcamera_source\.cpp$",
    r"libusb\.h": r"^acquire/usb_transport\.c$",
    r"openssl/.*": r"^pipeline/core/hash\.c$",
    r"n?curses(w/.*)?\.h": r"^ui/",
    r"(seccomp|linux/(landlock|seccomp))\.h": r"^pipeline/core/sandbox\.c$",
}

# C only: C++ files of foreign libraries have other doors (new, delete).
BANNED = ("malloc calloc realloc free strcpy strcat sprintf atoi atol atof strtod fopen open openat "
          "sqlite3_open sqlite3_open_v2 sqlite3_exec system popen exit").split()
BANNED_CALL = re.compile(r"(?<![\w.>])(" + "|".join(BANNED) + r")\s*\(")
DOOR = "/* door */"
INCLUDE = re.compile(r'^\s*#\s*include\s+(["<])([^">]+)[">]')
# A statement that begins with a call of ours which takes err and lets its answer fall.
DROPPED = re.compile(r"^\s+gsn_\w+\((?!.*\breturn\b).*[(, ]err\);\s*$")
INTERNAL = re.compile(r"_(internal|parts)\.h$")
STRUCT = re.compile(r"^struct\s+(gsn_\w+)\s*\{", re.M)
STATEMENT_ENDS = (";", "{", "}", ":", "*/")


def strip_comments(text):
    """Blanks comments and string contents, keeping the line structure and door marks."""
    def blank(match):
        piece = match.group(0)
        if piece.startswith('"'):
            return '""'
        if piece == DOOR:
            return piece
        return "\n" * piece.count("\n")
    return re.sub(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\\n])*"', blank, text, flags=re.S)


def layer_of(path):
    best = ""
    for folder in LAYERS:
        if path.startswith(folder + "/") and len(folder) > len(best):
            best = folder
    return best


def allowed(owner, header):
    if layer_of(header) == "pipeline/phantom":
        return owner == "pipeline/phantom"
    if owner in ("pipeline/specimen", "systemd"):
        return any(header.startswith(f + "/") for f in LAYERS[owner] + (owner,))
    target = layer_of(header)
    return target == owner or target in LAYERS[owner]


def check_includes(path, text, say):
    owner = layer_of(path)
    for number, line in enumerate(text.splitlines(), 1):
        match = INCLUDE.match(line)
        if not match:
            continue
        quoted, header = match.groups()
        if quoted == '"' and owner and header.split("/")[0] in ROOMS and not allowed(owner, header):
            say(path, number, f"{owner} may not include {header}")
        if quoted == '"' and header.split("/")[0] not in ROOMS and "/" not in header \
                and not header.endswith(".inc"):
            say(path, number, f'includes are written from the root, not "{header}"')
        for pattern, door in FOREIGN.items():
            if quoted == "<" and re.fullmatch(pattern, header) and not re.match(door, path):
                say(path, number, f"<{header}> may be named only in {door}")


def check_calls(path, text, say):
    if not path.endswith((".c", ".h")):
        return
    previous = ";"
    for number, line in enumerate(strip_comments(text).splitlines(), 1):
        bare = line.rstrip()
        for match in BANNED_CALL.finditer(line):
            # A prototype or member of ours with that name is no call of the banned one.
            if DOOR not in line:
                say(path, number, f"{match.group(1)}() has one door, and this is not it")
        if DROPPED.match(bare) and previous.endswith(STATEMENT_ENDS):
            say(path, number, "an error is dropped: use the answer of this call or write (void)")
        if bare.strip():
            previous = bare.strip()


def check_internal(path, text, say):
    """A header of one folder's own is included by that folder alone."""
    for number, line in enumerate(text.splitlines(), 1):
        match = INCLUDE.match(line)
        if match and INTERNAL.search(match.group(2)) and \
                match.group(2).rsplit("/", 1)[0] != path.rsplit("/", 1)[0]:
            say(path, number, f"{match.group(2)} is its own folder's")


def check_structs(texts, say):
    """One name, one structure: headers of two folders can be included together."""
    where = {}
    for path, text in texts.items():
        for match in STRUCT.finditer(strip_comments(text)):
            where.setdefault(match.group(1), []).append(path)
    for name, paths in where.items():
        if len(paths) > 1:
            say(paths[1], 1, f"struct {name} is defined in {paths[0]} too")


def check_doors(texts, say):
    """A door that nobody walks through is no rule."""
    for pattern in FOREIGN:
        include = re.compile(r'^\s*#\s*include\s+<' + pattern + r'>', re.M)
        if not any(include.search(text) for text in texts.values()):
            say("tests/layers/house_rules.py", 1, f"no file includes <{pattern}>: the door goes")


def check_licence(path, text, say):
    if path.endswith((".c", ".h", ".cpp", ".hpp")) and \
            "SPDX-License-Identifier: AGPL-3.0-or-later" not in text[:120]:
        say(path, 1, "the SPDX line is missing")


def check_opening(path, text, say):
    """A source opens with what it does, before its first line of code."""
    if path.endswith((".c", ".cpp")) and not re.match(r"/\*.*?\*/\n\s*/\* +(?!clang-format|-)[`\w]", text):
        say(path, 2, "the file does not open with a comment: what it does, by which method, how it "
                     "fails, what it costs")


def check_width(path, text, say):
    for number, line in enumerate(text.splitlines(), 1):
        if len(line) > WIDEST:
            say(path, number, f"{len(line)} columns, {WIDEST} at most")


def check(root):
    found = []

    def say(path, number, sentence):
        found.append(f"{path}:{number}: {sentence}")
    texts = {}
    for room in ROOMS:
        for file in sorted((root / room).rglob("*")):
            if file.suffix not in (".c", ".h", ".cpp", ".hpp"):
                continue
            path = file.relative_to(root).as_posix()
            text = texts[path] = file.read_text(encoding="utf-8")
            check_includes(path, text, say)
            check_calls(path, text, say)
            check_internal(path, text, say)
            check_licence(path, text, say)
            check_opening(path, text, say)
            check_width(path, text, say)
    check_structs(texts, say)
    check_doors(texts, say)
    return found


SPDX = "/* SPDX-License-Identifier: AGPL-3.0-or-later */\n"
PLANTED = {
    "a layer violation": ("storage/planted.c", SPDX + '#include "pipeline/model/dms.h"\n',
                          "storage may not include"),
    "ui reaching into the pipeline": ("ui/planted.c", SPDX + '#include "pipeline/specimen/protocol.h"\n',
                                      "ui may not include"),
    "the product built on the phantom": (
        "systemd/planted.c", SPDX + '#include "pipeline/phantom/plan.h"\n', "systemd may not include"),
    "a foreign header": ("ui/planted.c", SPDX + "#include <sqlite3.h>\n", "may be named only in"),
    "a banned call": ("acquire/planted.c", SPDX + "void f(void)\n{\n    void *p = malloc(3);\n}\n",
                      "malloc() has one door"),
    "an unhandled error": ("pipeline/core/planted.c",
                           SPDX + "int f(struct gsn_error *err)\n{\n    gsn_file_mkdir(\"x\", err);\n"
                           "    return 0;\n}\n", "an error is dropped"),
    "a folder's own header": (
        "pipeline/planted.c", SPDX + '#include "pipeline/model/dms_internal.h"\n', "own folder's"),
    "a name for two structures": (
        "ui/planted.h", SPDX + "struct gsn_error {\n    int code;\n};\n", "is defined in"),
    "a missing licence line": ("acquire/planted.c", "int f(void);\n", "SPDX line is missing"),
    "a line that is too long": ("ui/planted.h", SPDX + "/* " + 98 * "x" + " */\n", "100 at most"),
    "a source without an opening": (
        "ui/planted.cpp", SPDX + '#include "ui/planted.h"\n\n/* What f is. */\nint f(void);\n',
        "does not open with a comment"),
}


def self_test(root):
    for name, (path, text, sentence) in PLANTED.items():
        with tempfile.TemporaryDirectory() as folder:
            copy = pathlib.Path(folder)
            for room in ROOMS:
                if (root / room).is_dir():
                    shutil.copytree(root / room, copy / room)
            (copy / path).write_text(text, encoding="utf-8")
            if not any(path in line and sentence in line for line in check(copy)):
                print(f"{name}, planted in {path}, was not found")
                return 1
            print(f"{name}: found")
    FOREIGN[r"never\.h"] = r"^ui/"
    if not any("the door goes" in line for line in check(root)):
        print("a door that no file uses was not found")
        return 1
    print("a door that no file uses: found")
    return 0


def main():
    root = pathlib.Path(sys.argv[1])
    if "--self-test" in sys.argv[2:]:
        return self_test(root)
    found = check(root)
    print("\n".join(found) if found else "the rules of the house hold")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
