#!/bin/bash
# SPDX-License-Identifier: AGPL-3.0-or-later
# What a technician gets who presses the tabulator. The program is the real one for its verbs; a
# store's answers are played, so that names with blanks are among them.
#     test_completion.sh SOURCES GIESON
set -u
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
status=0
cat >"$work/gieson" <<PLAYED
#!/bin/sh
[ "\$1" != --help ] || exec "$2" --help
store=\$GIESON_STORE
[ "\$1" != --store ] || { store=\$2; shift 2; }
[ "\$store" = "/srv/my lab" ] || exit 66
case \$1 in
status) printf '{\n  "sources": [\n    {\n      "source": "scanner",\n      "address": "ptp:any"\n    }\n  ],\n  "unfiled": [\n    {\n      "scan": 12,\n      "source": "scanner"\n    }\n  ],\n  "specimens": [\n    {\n      "specimen": "R07-left",\n      "group": "x"\n    },\n    {\n      "specimen": "R07 right",\n      "group": "x"\n    }\n  ]\n}\n' ;;
esac
PLAYED
chmod +x "$work/gieson"
mkdir -p "$work/scans one/inner"
: >"$work/panel.tif"
cd "$work" || exit 1
# shellcheck source=/dev/null
source "$1/docs/completion/gieson" || exit 1
export GIESON_STORE="/srv/my lab"

# completes LINE EXPECTED: the last word of LINE is the current one.
completes() {
    eval "COMP_WORDS=($1)"
    [[ $1 != *' ' ]] || COMP_WORDS+=("")
    COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
    _gieson "$work/gieson"
    local got
    got=$(printf '%s|' "${COMPREPLY[@]}")
    if [ "$got" != "$2|" ]; then
        echo "wrong: '$1' completes to '$got', not '$2|'"
        status=1
    fi
}

completes "gieson sta" "status"
completes "gieson --store x re" "report|render|retry|restore|register"
completes "gieson show R07-" "R07-left"
completes "gieson report " "R07\\ right|R07-left"
completes "gieson --store nowhere show " ""
completes "gieson import sc" "scans one"
completes "gieson import --vol" "--volume"
completes "gieson import --volume pan" "panel.tif"
completes "gieson check pan" "panel.tif"
completes "gieson run --th" "--threads"
completes "gieson run --threads " ""
completes "gieson expect " "scanner"
completes "gieson expect scanner R07-" "R07-left"
completes "gieson file " "12"
completes "gieson file 12 R07-" "R07-left"
completes "gieson file 12 --panel 3 R07-" "R07-left"
completes "gieson export R07-" "R07-left"
completes "gieson export R07-left pan" "panel.tif"
completes "gieson export R07-left x.stl --lev" "--level"
completes "gieson render R07-left x.png --trans" "--translucent"
completes "gieson render R07-left x.png --true" "--true-colour"
completes "gieson probe R07-" "R07-left"
completes "gieson integral R07-left --pl" "--plane"
completes "gieson capture s" "scanner"
completes "gieson capture scanner --b" "--blank"
completes "gieson expect scanner --n" "--nobody"
completes "gieson --ver" "--version"
completes "gieson status x" ""

# Every verb that the program lists is offered.
eval 'COMP_WORDS=(gieson "")'
COMP_CWORD=1
_gieson "$work/gieson"
listed=$("$2" --help | sed -n '/^Verbs:/,$p' | grep -cE '^  [a-z]')
if [ "$listed" -lt 5 ] || [ "${#COMPREPLY[@]}" -ne "$listed" ]; then
    echo "wrong: ${#COMPREPLY[@]} verbs are offered, the program lists $listed"
    status=1
fi
exit $status
