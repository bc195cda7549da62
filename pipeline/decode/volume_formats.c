/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The headers of the three volume formats, each to the one description of volume_internal.h.
 *
 * INRIMAGE-4: "KEY=VALUE" lines, filled up with empty ones, to the line "##}".
 * MetaImage: "Key = Value" lines of which ElementDataFile is the last.
 * NRRD: "field: value" lines up to an empty one, behind which attached data follow.
 *
 * Method: line by line into one description, by words and numbers that the three have in common;
 * keys that do not change what voxels mean are skipped, and a value that is not understood is
 * refused by its key. Numbers do not follow the locale.
 *
 * Failure: GSN_E_INPUT with the key; GSN_E_UNSUPPORTED for what is stated well and not read.
 * Cost: linear in the header. */
#include "pipeline/decode/volume_internal.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
#include <strings.h>

/* --- words and numbers of a header --- */

static int is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r' || c == '\n';
}

static int is_gap(char c)
{
    return is_blank(c) || c == ',' || c == '(' || c == ')';
}

static struct gsn_words trim_words(struct gsn_words words)
{
    while (words.size && is_blank(words.at[0])) {
        words.at++;
        words.size--;
    }
    while (words.size && is_blank(words.at[words.size - 1]))
        words.size--;
    return words;
}

int gsn_words_line(struct gsn_words *rest, struct gsn_words *ret_line)
{
    const char *end = rest->size ? memchr(rest->at, '\n', rest->size) : NULL;
    const size_t size = end ? (size_t)(end - rest->at) : rest->size;
    const size_t step = end ? size + 1 : size;

    if (rest->size == 0)
        return 0;
    *ret_line = (struct gsn_words){ rest->at, size };
    if (size && ret_line->at[size - 1] == '\r')
        ret_line->size--;
    rest->at += step;
    rest->size -= step;
    return 1;
}

int gsn_words_split(struct gsn_words line, const char *mark, struct gsn_words *ret_key,
                    struct gsn_words *ret_value)
{
    const char *found = memmem(line.at, line.size, mark, strlen(mark));
    const size_t before = found ? (size_t)(found - line.at) : 0;
    const size_t behind = before + strlen(mark);

    if (!found)
        return 0;
    *ret_key = trim_words((struct gsn_words){ line.at, before });
    *ret_value = trim_words((struct gsn_words){ line.at + behind, line.size - behind });
    return 1;
}

int gsn_words_are(struct gsn_words words, const char *text)
{
    return words.size == strlen(text) && strncasecmp(words.at, text, words.size) == 0;
}

/* Digits with at most one point. 19 digits fit 64 bits; those beyond only shift the exponent. */
static size_t take_digits(struct gsn_words *w, uint64_t *mantissa, int *exponent)
{
    size_t digits = 0;
    int point = 0;

    for (; w->size; w->at++, w->size--) {
        const char c = w->at[0];

        if (c == '.' && !point) {
            point = 1;
        } else if (c >= '0' && c <= '9') {
            digits++;
            if (*mantissa < UINT64_MAX / 10 - 1)
                *mantissa = *mantissa * 10 + (uint64_t)(c - '0');
            else
                (*exponent)++;
            *exponent -= point;
        } else {
            break;
        }
    }
    return digits;
}

static int take_sign(struct gsn_words *w)
{
    const int negative = w->size && w->at[0] == '-';

    if (w->size && (w->at[0] == '-' || w->at[0] == '+')) {
        w->at++;
        w->size--;
    }
    return negative ? -1 : 1;
}

/* Returns 0 unless an exponent is absent or complete and modest. */
static int take_exponent(struct gsn_words *w, int *exponent)
{
    uint64_t number = 0;
    int beyond = 0, sign;

    if (!w->size || (w->at[0] != 'e' && w->at[0] != 'E'))
        return 1;
    w->at++;
    w->size--;
    sign = take_sign(w);
    if (!take_digits(w, &number, &beyond) || beyond || number > 300)
        return 0;
    *exponent += sign * (int)number;
    return 1;
}

/* strtod() would follow the locale: "3,5" on a German machine. */
static int take_number(struct gsn_words *w, double *ret_number)
{
    const int sign = take_sign(w);
    uint64_t mantissa = 0;
    long double value;
    int exponent = 0;

    if (!take_digits(w, &mantissa, &exponent) || !take_exponent(w, &exponent))
        return 0;
    if (w->size && !is_gap(w->at[0]))
        return 0;
    /* Powers of ten up to 10^27 are exact in the 64 bits of a long double's mantissa. */
    value = (long double)mantissa;
    value = exponent < 0 ? value / powl(10.0L, -exponent) : value * powl(10.0L, exponent);
    *ret_number = sign * (double)value;
    return isfinite(*ret_number) != 0;
}

int gsn_words_numbers(struct gsn_words words, double *ret_numbers, size_t count)
{
    for (size_t i = 0;; i++) {
        while (words.size && is_gap(words.at[0])) {
            words.at++;
            words.size--;
        }
        if (words.size == 0)
            return i == count;
        if (i == count || !take_number(&words, &ret_numbers[i]))
            return 0;
    }
}

static int read_sizes(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
{
    double n[3];

    if (!gsn_words_numbers(value, n, 3))
        return gsn_fail(err, GSN_E_INPUT, "the sizes \"%.*s\" are not three numbers",
                        (int)(value.size < 60 ? value.size : 60), value.at);
    for (size_t i = 0; i < 3; i++)
        if (n[i] < 1 || n[i] > 1e6 || floor(n[i]) < n[i])
            return gsn_fail(err, GSN_E_INPUT,
                            "size %zu is %g: a size is a whole number from 1 to 1000000", i + 1,
                            n[i]);
    at->nx = (size_t)n[0];
    at->ny = (size_t)n[1];
    at->nz = (size_t)n[2];
    return GSN_OK;
}

static int read_spacing(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
{
    double step[3];

    if (!gsn_words_numbers(value, step, 3) || step[0] <= 0 || step[1] <= 0 || step[2] <= 0)
        return gsn_fail(err, GSN_E_INPUT, "the spacing \"%.*s\" is not three numbers above 0",
                        (int)(value.size < 60 ? value.size : 60), value.at);
    at->step_um = gsn_vec3_make(step[0], step[1], step[2]);
    return GSN_OK;
}

static int read_origin(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
{
    double first[3];

    if (!gsn_words_numbers(value, first, 3))
        return gsn_fail(err, GSN_E_INPUT, "the origin \"%.*s\" is not three numbers",
                        (int)(value.size < 60 ? value.size : 60), value.at);
    at->origin_um = gsn_vec3_make(first[0], first[1], first[2]);
    return GSN_OK;
}

/* A header from elsewhere must not make us read any file but its own neighbour. */
static int read_data_file(struct gsn_words value, struct gsn_volume_header *header,
                          struct gsn_error *err)
{
    if (value.size == 0 || value.size >= sizeof header->data_file ||
        memchr(value.at, '/', value.size) || memchr(value.at, 0, value.size) || value.at[0] == '.')
        return gsn_fail(err, GSN_E_INPUT,
                        "the data file \"%.*s\" is not a plain name of a file beside the header",
                        (int)(value.size < 100 ? value.size : 100), value.at);
    if (memchr(value.at, '%', value.size) || gsn_words_are(value, "LIST"))
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a volume in many files is not read: write it as one file");
    memcpy(header->data_file, value.at, value.size);
    header->data_file[value.size] = '\0';
    return GSN_OK;
}

static int read_whole(struct gsn_words value, const char *field, size_t *ret_number,
                      struct gsn_error *err)
{
    double number;

    if (!gsn_words_numbers(value, &number, 1) || number < 0 || number > 1e15 ||
        floor(number) < number)
        return gsn_fail(err, GSN_E_INPUT, "%s \"%.*s\" is not a whole number", field,
                        (int)(value.size < 60 ? value.size : 60), value.at);
    *ret_number = (size_t)number;
    return GSN_OK;
}

/* --- INRIMAGE-4 --- */

/* INRIMAGE-4: "KEY=VALUE" lines, filled up with empty ones, to the line "##}". */

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
static struct gsn_words join_fields(const struct gsn_words part[3], char *text, size_t room)
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

    r = read_sizes(join_fields(inr->size, text, sizeof text), at, err);
    if (r >= 0)
        r = read_spacing(join_fields(inr->step, text, sizeof text), at, err);
    if (r >= 0 && (inr->first[0].size || inr->first[1].size || inr->first[2].size))
        r = read_origin(join_fields(inr->first, text, sizeof text), at, err);
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

/* --- MetaImage --- */

/* MetaImage: "Key = Value" lines of which ElementDataFile is the last. */

static const struct {
    const char *name;
    enum gsn_voxel voxel;
} mhd_types[] = {
    { "MET_UCHAR", GSN_VOXEL_U8 },   { "MET_CHAR", GSN_VOXEL_S8 },
    { "MET_USHORT", GSN_VOXEL_U16 }, { "MET_SHORT", GSN_VOXEL_S16 },
    { "MET_UINT", GSN_VOXEL_U32 },   { "MET_INT", GSN_VOXEL_S32 },
    { "MET_FLOAT", GSN_VOXEL_F32 },  { "MET_DOUBLE", GSN_VOXEL_F64 },
};

static int read_mhd_type(struct gsn_words value, struct gsn_volume_header *header,
                         struct gsn_error *err)
{
    for (size_t i = 0; i < sizeof mhd_types / sizeof mhd_types[0]; i++)
        if (gsn_words_are(value, mhd_types[i].name))
            header->voxel = mhd_types[i].voxel;
    if (header->voxel == GSN_VOXEL_NONE)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "ElementType %.*s is not read",
                        (int)(value.size < 40 ? value.size : 40), value.at);
    return GSN_OK;
}

static int check_upright(struct gsn_words value, struct gsn_error *err)
{
    double m[9];

    if (!gsn_words_numbers(value, m, 9))
        return gsn_fail(err, GSN_E_INPUT, "TransformMatrix is not nine numbers");
    for (size_t i = 0; i < 9; i++)
        if (fabs(m[i] - (i % 4 == 0)) > 1e-6)
            return gsn_fail(err, GSN_E_UNSUPPORTED,
                            "the volume's axes are turned: resample it into the block frame");
    return GSN_OK;
}

static int check_word(struct gsn_words value, const char *only, const char *field,
                      struct gsn_error *err)
{
    if (gsn_words_are(value, only))
        return GSN_OK;
    return gsn_fail(err, GSN_E_UNSUPPORTED, "%s = %.*s is not read, only %s", field,
                    (int)(value.size < 40 ? value.size : 40), value.at, only);
}

/* -1 means that the data are the last bytes of the file, whatever stands before. */
static int read_header_size(struct gsn_words value, struct gsn_volume_header *header,
                            struct gsn_error *err)
{
    header->from_end = gsn_words_are(value, "-1");
    return header->from_end ? GSN_OK : read_whole(value, "HeaderSize", &header->data_at, err);
}

static int take_mhd_field(struct gsn_words key, struct gsn_words value,
                          struct gsn_volume_header *header, struct gsn_error *err)
{
    struct gsn_lattice *at = &header->at;

    if (gsn_words_are(key, "NDims"))
        return check_word(value, "3", "NDims", err);
    if (gsn_words_are(key, "BinaryData"))
        return check_word(value, "True", "BinaryData", err);
    if (gsn_words_are(key, "ElementNumberOfChannels"))
        return check_word(value, "1", "ElementNumberOfChannels", err);
    if (gsn_words_are(key, "DimSize"))
        return read_sizes(value, at, err);
    if (gsn_words_are(key, "ElementType"))
        return read_mhd_type(value, header, err);
    if (gsn_words_are(key, "ElementSpacing") ||
        (gsn_words_are(key, "ElementSize") && at->step_um.x <= 0))
        return read_spacing(value, at, err);
    if (gsn_words_are(key, "Offset") || gsn_words_are(key, "Position") ||
        gsn_words_are(key, "Origin"))
        return read_origin(value, at, err);
    if (gsn_words_are(key, "TransformMatrix") || gsn_words_are(key, "Rotation") ||
        gsn_words_are(key, "Orientation"))
        return check_upright(value, err);
    if (gsn_words_are(key, "HeaderSize"))
        return read_header_size(value, header, err);
    if (gsn_words_are(key, "ElementByteOrderMSB") || gsn_words_are(key, "BinaryDataByteOrderMSB"))
        header->big_endian = gsn_words_are(value, "True");
    if (gsn_words_are(key, "CompressedData"))
        header->compressed = gsn_words_are(value, "True");
    return GSN_OK;
}

static int take_data_file(struct gsn_words value, size_t behind, struct gsn_volume_header *header,
                          struct gsn_error *err)
{
    if (!gsn_words_are(value, "LOCAL"))
        return read_data_file(value, header, err);
    if (header->data_at)
        return gsn_fail(err, GSN_E_INPUT, "HeaderSize makes no sense beside LOCAL data");
    header->data_at = behind;
    return GSN_OK;
}

int gsn_mhd_parse(struct gsn_words file, struct gsn_volume_header *header, struct gsn_error *err)
{
    struct gsn_words rest = file, line, key, value;
    int r = GSN_OK;

    while (r >= 0 && gsn_words_line(&rest, &line)) {
        if (!gsn_words_split(line, "=", &key, &value))
            continue;
        if (gsn_words_are(key, "ElementDataFile"))
            return take_data_file(value, (size_t)(rest.at - file.at), header, err);
        r = take_mhd_field(key, value, header, err);
    }
    return r < 0 ? r : gsn_fail(err, GSN_E_INPUT, "a MetaImage without ElementDataFile");
}

/* --- NRRD --- */

/* NRRD: "field: value" lines up to an empty one, behind which attached data follow. */

static const struct {
    const char *name;
    enum gsn_voxel voxel;
} nrrd_types[] = {
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

static int read_nrrd_type(struct gsn_words value, struct gsn_volume_header *header,
                          struct gsn_error *err)
{
    for (size_t i = 0; i < sizeof nrrd_types / sizeof nrrd_types[0]; i++)
        if (gsn_words_are(value, nrrd_types[i].name))
            header->voxel = nrrd_types[i].voxel;
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
    return header->from_end ? GSN_OK : read_whole(value, "byte skip", &header->data_at, err);
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

static int take_nrrd_field(struct gsn_words key, struct gsn_words value, struct nrrd *nrrd,
                           struct gsn_error *err)
{
    struct gsn_volume_header *header = nrrd->header;

    if (gsn_words_are(key, "dimension"))
        return take_dimension(value, nrrd, err);
    if (gsn_words_are(key, "type"))
        return read_nrrd_type(value, header, err);
    if (gsn_words_are(key, "sizes"))
        return read_sizes(value, &header->at, err);
    if (gsn_words_are(key, "encoding"))
        return read_encoding(value, nrrd, err);
    if (gsn_words_are(key, "endian"))
        return read_endian(value, nrrd, err);
    if (gsn_words_are(key, "spacings"))
        return read_spacing(value, &header->at, err);
    if (gsn_words_are(key, "space directions"))
        return read_directions(value, &header->at, err);
    if (gsn_words_are(key, "space origin"))
        return read_origin(value, &header->at, err);
    if (gsn_words_are(key, "units") || gsn_words_are(key, "space units"))
        return read_units(value, header, err);
    if (gsn_words_are(key, "byte skip") || gsn_words_are(key, "byteskip"))
        return take_skip(value, header, err);
    if (gsn_words_are(key, "line skip") || gsn_words_are(key, "lineskip"))
        return take_line_skip(value, err);
    if (gsn_words_are(key, "data file") || gsn_words_are(key, "datafile"))
        return read_data_file(value, header, err);
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
            r = take_nrrd_field(key, value, &nrrd, err);
    }
    if (r >= 0)
        r = check_fields(&nrrd, err);
    if (r >= 0 && header->data_file[0] == '\0')
        header->data_at += (size_t)(rest.at - file.at);
    return r;
}
