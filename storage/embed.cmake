# SPDX-License-Identifier: AGPL-3.0-or-later
# cmake -DFROM=file -DTO=file.c -DNAME=symbol -P embed.cmake: a text as a C array with a final zero.
file(READ ${FROM} hex HEX)
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "0x\\1, " bytes "${hex}")
string(REGEX REPLACE "((0x.., ){16})" "\\1\n" bytes "${bytes}")
file(WRITE ${TO}
    "/* Made from ${NAME}'s SQL by embed.cmake. */\n"
    "#include \"storage/sql.h\"\n"
    "const char ${NAME}[] = {\n${bytes}0x00 };\n")
