/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* NRRD: "field: value" lines up to an empty one, behind which attached data follow. */
#include "pipeline/decode/volume_header.h"

#include <math.h>

static const struct {
    const char *name;
    enum gsn_voxel voxel;
} types[] = {
    { "uchar", GSN_VOXEL_U8 },
    { "unsigned char", GSN_VOXEL_U8 },
    { "uint8", GSN_VOXEL_U8 },
    { "uint8_t", GSN_VOXEL_U8 },
    { "signed char", GSN_VOXEL_S8 },
    { "int8", GSN_VOXEL_S8 },
    { "int8_t", GSN_VOXEL_S8 },
    { "ushort", GSN_VOXEL_U16 },
    { "unsigned short", GSN_VOXEL_U16 },
    { "uint16", GSN_VOXEL_U16 },
    { "uint16_t", GSN_VOXEL_U16 },
    { "short", GSN_VOXEL_S16 },
    { "int16", GSN_VOXEL_S16 },
    { "int16_t", GSN_VOXEL_S16 },
    { "uint", GSN_VOXEL_U32 },
    { "unsigned int", GSN_VOXEL_U32 },
    { "uint32", GSN_VOXEL_U32 },
    { "uint32_t", GSN_VOXEL_U32 },
    { "int", GSN_VOXEL_S32 },
    { "int32", GSN_VOXEL_S32 },
    { "int32_t", GSN_VOXEL_S32 },
    { "float", GSN_VOXEL_F32 },
    { "double", GSN_VOXEL_F64 },
};

/* What the fields said so far that the common header has no place for. */
struct nrrd {
    struct gsn_volume_header *header;
    int has_dimension, has_encoding, has_endian;
};

static int read_type(struct gsn_words value, struct gsn_volume_header *header,
                     struct gsn_error *err)
{
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (gsn_words_are(value, types[i].name))
            header->voxel = types[i].voxel;
    if (header->voxel == GSN_VOXEL_NONE)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "NRRD type %.*s is not read",
                        (int)(value.size < 40 ? value.size : 40), value.at);
    return GSN_OK;
}

static int read_encoding(struct gsn_words value, struct nrrd *nrrd, struct gsn_error *err)
{
    nrrd->header->compressed = gsn_words_are(value, "gzip") || gsn_words_are(value, "gz");
    nrrd->has_encoding = 1;
    if (!nrrd->header->compressed && !gsn_words_are(value, "raw"))
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "NRRD encoding %.*s is not read: write it as raw or gzip",
                        (int)(value.size < 40 ? value.size : 40), value.at);
    return GSN_OK;
}

static int read_endian(struct gsn_words value, struct nrrd *nrrd, struct gsn_error *err)
{
    nrrd->header->big_endian = gsn_words_are(value, "big");
    nrrd->has_endian = 1;
    if (!nrrd->header->big_endian && !gsn_words_are(value, "little"))
        return gsn_fail(err, GSN_E_INPUT, "NRRD endian is neither little nor big");
    return GSN_OK;
}

/* Three vectors; only a box along the axes can be laid into the block frame as it is. */
static int read_directions(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
{
    double m[9];

    if (!gsn_words_numbers(value, m, 9))
        return gsn_fail(err, GSN_E_INPUT, "NRRD space directions are not three vectors");
    for (size_t i = 0; i < 9; i++)
        if (i % 4 == 0 ? m[i] <= 0 : m[i] > 0 || m[i] < 0)
            return gsn_fail(err, GSN_E_UNSUPPORTED,
                            "the volume's axes are turned: resample it into the block frame");
    at->step_um = gsn_vec3_make(m[0], m[4], m[8]);
    return GSN_OK;
}

/* Micrometres in this unit; 0: not one that is read. */
static double unit_of(struct gsn_words word)
{
    static const struct {
        const char *name;
        double um;
    } units[] = {
        { "\"um\"", 1 },
        { "\"\xc2\xb5m\"", 1 },
        { "\"\xce\xbcm\"", 1 },
        { "\"micron\"", 1 },
        { "\"microns\"", 1 },
        { "\"micrometer\"", 1 },
        { "\"micrometre\"", 1 },
        { "\"mm\"", 1000 },
        { "\"millimeter\"", 1000 },
        { "\"millimetre\"", 1000 },
    };

    for (size_t i = 0; i < sizeof units / sizeof units[0]; i++)
        if (gsn_words_are(word, units[i].name))
            return units[i].um;
    return 0;
}

/* A unit that is taken for another makes every volume wrong by powers of ten. */
static int read_units(struct gsn_words value, struct gsn_volume_header *header,
                      struct gsn_error *err)
{
    while (value.size) {
        size_t size = 0;
        double um;

        while (size < value.size && value.at[size] != ' ')
            size++;
        um = unit_of((struct gsn_words){ value.at, size });
        if (size && (!(um > 0) || (header->unit_um > 0 && fabs(um - header->unit_um) > 0)))
            return gsn_fail(err, GSN_E_UNSUPPORTED,
                            "NRRD units %.*s are not read: write all of them as \"um\" or \"mm\"",
                            (int)(size < 40 ? size : 40), value.at);
        header->unit_um = size ? um : header->unit_um;
        size += size < value.size;
        value.at += size;
        value.size -= size;
    }
    return GSN_OK;
}

static int take_skip(struct gsn_words value, struct gsn_volume_header *header,
                     struct gsn_error *err)
{
    header->from_end = gsn_words_are(value, "-1");
    return header->from_end ? GSN_OK : gsn_header_whole(value, "byte skip", &header->data_at, err);
}

static int take_dimension(struct gsn_words value, struct nrrd *nrrd, struct gsn_error *err)
{
    nrrd->has_dimension = gsn_words_are(value, "3");
    return nrrd->has_dimension
               ? GSN_OK
               : gsn_fail(err, GSN_E_UNSUPPORTED, "an NRRD of dimension %.*s is not read, only 3",
                          (int)(value.size < 20 ? value.size : 20), value.at);
}

static int take_line_skip(struct gsn_words value, struct gsn_error *err)
{
    if (gsn_words_are(value, "0"))
        return GSN_OK;
    return gsn_fail(err, GSN_E_UNSUPPORTED, "an NRRD with line skip is not read: use byte skip");
}

static int take(struct gsn_words key, struct gsn_words value, struct nrrd *nrrd,
                struct gsn_error *err)
{
    struct gsn_volume_header *header = nrrd->header;

    if (gsn_words_are(key, "dimension"))
        return take_dimension(value, nrrd, err);
    if (gsn_words_are(key, "type"))
        return read_type(value, header, err);
    if (gsn_words_are(key, "sizes"))
        return gsn_header_sizes(value, &header->at, err);
    if (gsn_words_are(key, "encoding"))
        return read_encoding(value, nrrd, err);
    if (gsn_words_are(key, "endian"))
        return read_endian(value, nrrd, err);
    if (gsn_words_are(key, "spacings"))
        return gsn_header_spacing(value, &header->at, err);
    if (gsn_words_are(key, "space directions"))
        return read_directions(value, &header->at, err);
    if (gsn_words_are(key, "space origin"))
        return gsn_header_origin(value, &header->at, err);
    if (gsn_words_are(key, "units") || gsn_words_are(key, "space units"))
        return read_units(value, header, err);
    if (gsn_words_are(key, "byte skip") || gsn_words_are(key, "byteskip"))
        return take_skip(value, header, err);
    if (gsn_words_are(key, "line skip") || gsn_words_are(key, "lineskip"))
        return take_line_skip(value, err);
    if (gsn_words_are(key, "data file") || gsn_words_are(key, "datafile"))
        return gsn_header_data_file(value, header, err);
    return GSN_OK;
}

static int check_fields(const struct nrrd *nrrd, struct gsn_error *err)
{
    const struct gsn_volume_header *header = nrrd->header;
    const int wide = header->voxel != GSN_VOXEL_U8 && header->voxel != GSN_VOXEL_S8;

    if (!nrrd->has_dimension || !nrrd->has_encoding)
        return gsn_fail(err, GSN_E_INPUT, "an NRRD without %s",
                        nrrd->has_dimension ? "encoding" : "dimension");
    if (wide && !nrrd->has_endian)
        return gsn_fail(err, GSN_E_INPUT, "an NRRD of more than 8 bit without endian");
    return GSN_OK;
}

int gsn_nrrd_parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err)
{
    struct gsn_words rest = file, line, key, value;
    struct nrrd nrrd = { .header = header };
    int r = GSN_OK;

    (void)gsn_words_line(&rest, &line); /* the magic */
    while (r >= 0 && gsn_words_line(&rest, &line) && line.size > 0) {
        /* "key:=value" is the writer's own business, as is a comment. */
        if (line.at[0] != '#' && !gsn_words_split(line, ":=", &key, &value) &&
            gsn_words_split(line, ":", &key, &value))
            r = take(key, value, &nrrd, err);
    }
    if (r >= 0)
        r = check_fields(&nrrd, err);
    if (r >= 0 && header->data_file[0] == '\0')
        header->data_at += (size_t)(rest.at - file.at);
    return r;
}
