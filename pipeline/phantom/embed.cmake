# SPDX-License-Identifier: AGPL-3.0-or-later
# cmake -DINPUT=tiles.bin -DOUTPUT=tiles.c -P embed.cmake: the bytes as a C array.
file(READ ${INPUT} bytes HEX)
string(REGEX REPLACE "(................................)" "\\1\n" bytes "${bytes}")
string(REGEX REPLACE "([0-9a-f][0-9a-f])" "(int8_t)0x\\1, " bytes "${bytes}")
file(WRITE ${OUTPUT}
    "/* SPDX-License-Identifier: AGPL-3.0-or-later */\n"
    "#include \"pipeline/phantom/tiles.h\"\n\n"
    "const int8_t gsn_phantom_tiles[GSN_PHANTOM_TILES_SIZE] = {\n${bytes}};\n")
