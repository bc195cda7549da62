/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* MetaImage: "Key = Value" lines of which ElementDataFile is the last. */
#include "pipeline/decode/volume_header.h"

#include <math.h>

static const struct {
    const char *name;
    enum gsn_voxel voxel;
} types[] = {
    { "MET_UCHAR", GSN_VOXEL_U8 },   { "MET_CHAR", GSN_VOXEL_S8 },
    { "MET_USHORT", GSN_VOXEL_U16 }, { "MET_SHORT", GSN_VOXEL_S16 },
    { "MET_UINT", GSN_VOXEL_U32 },   { "MET_INT", GSN_VOXEL_S32 },
    { "MET_FLOAT", GSN_VOXEL_F32 },  { "MET_DOUBLE", GSN_VOXEL_F64 },
};

static int read_type(struct gsn_words value, struct gsn_volume_header *header,
                     struct gsn_error *err)
{
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++)
        if (gsn_words_are(value, types[i].name))
            header->voxel = types[i].voxel;
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
    return header->from_end ? GSN_OK : gsn_header_whole(value, "HeaderSize", &header->data_at, err);
}

static int take(struct gsn_words key, struct gsn_words value, struct gsn_volume_header *header,
                struct gsn_error *err)
{
    struct gsn_lattice *at = &header->at;

    if (gsn_words_are(key, "NDims"))
        return check_word(value, "3", "NDims", err);
    if (gsn_words_are(key, "BinaryData"))
        return check_word(value, "True", "BinaryData", err);
    if (gsn_words_are(key, "ElementNumberOfChannels"))
        return check_word(value, "1", "ElementNumberOfChannels", err);
    if (gsn_words_are(key, "DimSize"))
        return gsn_header_sizes(value, at, err);
    if (gsn_words_are(key, "ElementType"))
        return read_type(value, header, err);
    if (gsn_words_are(key, "ElementSpacing") ||
        (gsn_words_are(key, "ElementSize") && at->step_um.x <= 0))
        return gsn_header_spacing(value, at, err);
    if (gsn_words_are(key, "Offset") || gsn_words_are(key, "Position") ||
        gsn_words_are(key, "Origin"))
        return gsn_header_origin(value, at, err);
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
        return gsn_header_data_file(value, header, err);
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
        r = take(key, value, header, err);
    }
    return r < 0 ? r : gsn_fail(err, GSN_E_INPUT, "a MetaImage without ElementDataFile");
}
