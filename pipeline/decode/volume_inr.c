/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* INRIMAGE-4: "KEY=VALUE" lines, filled up with empty ones, to the line "##}". */
#include "pipeline/decode/volume_header.h"

#include <string.h>

struct inr {
    struct gsn_words size[3], step[3], first[3];
    struct gsn_words type, bits, cpu, scale, vectors;
};

static const struct {
    const char *key;
    size_t field;
} keys[] = {
    { "XDIM", offsetof(struct inr, size[0]) }, { "YDIM", offsetof(struct inr, size[1]) },
    { "ZDIM", offsetof(struct inr, size[2]) }, { "VX", offsetof(struct inr, step[0]) },
    { "VY", offsetof(struct inr, step[1]) },   { "VZ", offsetof(struct inr, step[2]) },
    { "TX", offsetof(struct inr, first[0]) },  { "TY", offsetof(struct inr, first[1]) },
    { "TZ", offsetof(struct inr, first[2]) },  { "TYPE", offsetof(struct inr, type) },
    { "PIXSIZE", offsetof(struct inr, bits) }, { "CPU", offsetof(struct inr, cpu) },
    { "SCALE", offsetof(struct inr, scale) },  { "VDIM", offsetof(struct inr, vectors) },
};

static const struct {
    const char *type, *bits;
    enum gsn_voxel voxel;
} types[] = {
    { "unsigned fixed", "8 bits", GSN_VOXEL_U8 }, { "unsigned fixed", "16 bits", GSN_VOXEL_U16 },
    { "signed fixed", "16 bits", GSN_VOXEL_S16 }, { "float", "32 bits", GSN_VOXEL_F32 },
    { "float", "64 bits", GSN_VOXEL_F64 },
};

/* The format asks for a multiple of 256 bytes; CGAL's own example has 240, so the end mark decides.
 */
static size_t header_size(struct gsn_words file)
{
    const char *end = memmem(file.at, file.size, "\n##}\n", 5);

    return end ? (size_t)(end - file.at) + 5 : 0;
}

static void read_fields(struct gsn_words text, struct inr *inr)
{
    struct gsn_words line, key, value;

    while (gsn_words_line(&text, &line)) {
        if (!gsn_words_split(line, "=", &key, &value))
            continue;
        for (size_t i = 0; i < sizeof keys / sizeof keys[0]; i++)
            if (gsn_words_are(key, keys[i].key))
                memcpy((char *)inr + keys[i].field, &value, sizeof value);
    }
}

/* Three fields as one list, so that they are checked like those of the other formats. */
static struct gsn_words joined(const struct gsn_words part[3], char *text, size_t room)
{
    size_t used = 0;

    for (size_t i = 0; i < 3; i++) {
        if (part[i].size + 1 > room - used)
            return (struct gsn_words){ text, 0 };
        memcpy(text + used, part[i].at ? part[i].at : "", part[i].size);
        used += part[i].size;
        text[used++] = ' ';
    }
    return (struct gsn_words){ text, used };
}

static int read_lattice(const struct inr *inr, struct gsn_lattice *at, struct gsn_error *err)
{
    char text[128];
    int r;

    r = gsn_header_sizes(joined(inr->size, text, sizeof text), at, err);
    if (r >= 0)
        r = gsn_header_spacing(joined(inr->step, text, sizeof text), at, err);
    if (r >= 0 && (inr->first[0].size || inr->first[1].size || inr->first[2].size))
        r = gsn_header_origin(joined(inr->first, text, sizeof text), at, err);
    return r;
}

static int read_voxel(const struct inr *inr, struct gsn_volume_header *header,
                      struct gsn_error *err)
{
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (gsn_words_are(inr->type, types[i].type) && gsn_words_are(inr->bits, types[i].bits))
            header->voxel = types[i].voxel;
    if (header->voxel == GSN_VOXEL_NONE)
        return gsn_fail(
            err, GSN_E_UNSUPPORTED, "INRIMAGE type %.*s of %.*s is not read",
            (int)(inr->type.size < 40 ? inr->type.size : 40), inr->type.at ? inr->type.at : "",
            (int)(inr->bits.size < 20 ? inr->bits.size : 20), inr->bits.at ? inr->bits.at : "");
    if ((inr->scale.size && !gsn_words_are(inr->scale, "2**0")) ||
        (inr->vectors.size && !gsn_words_are(inr->vectors, "1")))
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "an INRIMAGE with a SCALE or with several values per voxel is not read");
    return GSN_OK;
}

static int read_byte_order(const struct inr *inr, struct gsn_volume_header *header,
                           struct gsn_error *err)
{
    header->big_endian = gsn_words_are(inr->cpu, "sun") || gsn_words_are(inr->cpu, "sgi");
    if (!header->big_endian && !gsn_words_are(inr->cpu, "decm") &&
        !gsn_words_are(inr->cpu, "alpha") && !gsn_words_are(inr->cpu, "pc") &&
        header->voxel != GSN_VOXEL_U8)
        return gsn_fail(err, GSN_E_INPUT,
                        "an INRIMAGE whose CPU is none of decm, alpha, pc, sun, "
                        "sgi: its byte order is unknown");
    return GSN_OK;
}

int gsn_inr_parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err)
{
    struct inr inr = { 0 };
    int r;

    header->data_at = header_size(file);
    if (header->data_at == 0)
        return gsn_fail(err, GSN_E_INPUT, "truncated INRIMAGE: its header does not end");
    read_fields((struct gsn_words){ file.at, header->data_at }, &inr);
    r = read_lattice(&inr, &header->at, err);
    if (r >= 0)
        r = read_voxel(&inr, header, err);
    return r < 0 ? r : read_byte_order(&inr, header, err);
}
