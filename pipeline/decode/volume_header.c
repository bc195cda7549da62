/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/volume_header.h"

#include <math.h>
#include <stdint.h>
#include <string.h>
#include <strings.h>

static int is_blank(char c)
{
    return c == ' ' || c == '\t' || c == '\r' || c == '\n';
}

static int is_gap(char c)
{
    return is_blank(c) || c == ',' || c == '(' || c == ')';
}

static struct gsn_words trim(struct gsn_words words)
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
    *ret_key = trim((struct gsn_words){ line.at, before });
    *ret_value = trim((struct gsn_words){ line.at + behind, line.size - behind });
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

int gsn_header_sizes(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
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

int gsn_header_spacing(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
{
    double step[3];

    if (!gsn_words_numbers(value, step, 3) || step[0] <= 0 || step[1] <= 0 || step[2] <= 0)
        return gsn_fail(err, GSN_E_INPUT, "the spacing \"%.*s\" is not three numbers above 0",
                        (int)(value.size < 60 ? value.size : 60), value.at);
    at->step_um = gsn_vec3_make(step[0], step[1], step[2]);
    return GSN_OK;
}

int gsn_header_origin(struct gsn_words value, struct gsn_lattice *at, struct gsn_error *err)
{
    double first[3];

    if (!gsn_words_numbers(value, first, 3))
        return gsn_fail(err, GSN_E_INPUT, "the origin \"%.*s\" is not three numbers",
                        (int)(value.size < 60 ? value.size : 60), value.at);
    at->origin_um = gsn_vec3_make(first[0], first[1], first[2]);
    return GSN_OK;
}

/* A header from elsewhere must not make us read any file but its own neighbour. */
int gsn_header_data_file(struct gsn_words value, struct gsn_volume_header *header,
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

int gsn_header_whole(struct gsn_words value, const char *field, size_t *ret_number,
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
