/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What every page of ours is made of: its head, pictures inside the file, units.
 *
 * Method: Content Security Policy (W3C) allows pictures inside the file, the style sheet and the
 * viewers' scripts by their SHA-256, and nothing else.
 *
 * Failure: GSN_E_NOMEM of a hash; the text remembers that memory ran out. Cost: linear in what is
 * shown; pictures grow by a third as base64. */
#include "pipeline/report/html_elements.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/hash.h"

void gsn_html_image(struct gsn_report_text *text, const struct gsn_report_png *png,
                    const char *said)
{
    gsn_report_text_raw(text, "<img alt=\"");
    gsn_report_text_escape(text, said);
    gsn_report_text_print(text, "\" width=\"%u\" height=\"%u\" src=\"data:image/%s;base64,",
                          png->width, png->height,
                          png->size > 1 && png->bytes[0] == 0xFF ? "jpeg" : "png");
    gsn_report_text_base64(text, png->bytes, png->size);
    gsn_report_text_raw(text, "\">");
}

void gsn_html_unit(struct gsn_report_text *text, const char *unit)
{
    static const char *const known[][2] = {
        { "mm3", "mm\xC2\xB3" },
        { "um3", "\xC2\xB5m\xC2\xB3" },
        { "mm2", "mm\xC2\xB2" },
        { "um2", "\xC2\xB5m\xC2\xB2" },
        { "um", "\xC2\xB5m" },
        { "percent", "%" },
        { "mm2/mm3", "mm\xC2\xB2/mm\xC2\xB3" },
        { "1/mm3", "1/mm\xC2\xB3" },
    };

    for (size_t i = 0; unit && i < sizeof known / sizeof known[0]; i++) {
        if (strcmp(unit, known[i][0]) == 0) {
            gsn_report_text_raw(text, known[i][1]);
            return;
        }
    }
    gsn_report_text_escape(text, unit);
}

/* 'sha256-...' as a policy names what it allows: base64 of the raw 32 bytes. */
static int add_hash(struct gsn_report_text *text, const unsigned char *bytes, size_t size,
                    struct gsn_error *err)
{
    struct gsn_digest digest;
    unsigned char raw[32];
    const int r = gsn_sha256(bytes, size, &digest, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < sizeof raw; i++) {
        const char high = digest.hex[2 * i], low = digest.hex[2 * i + 1];

        raw[i] = (unsigned char)((high <= '9' ? high - '0' : high - 'a' + 10) << 4 |
                                 (low <= '9' ? low - '0' : low - 'a' + 10));
    }
    gsn_report_text_raw(text, "'sha256-");
    gsn_report_text_base64(text, raw, sizeof raw);
    gsn_report_text_raw(text, "'");
    return GSN_OK;
}

static int add_policy(struct gsn_report_text *text, unsigned scripts, struct gsn_error *err)
{
    static const struct {
        const unsigned char *bytes;
        const size_t *size;
    } script[] = { /* by their bits */
                   { gsn_html_viewer_script, &gsn_html_viewer_script_size },
                   { gsn_html_alignment_script, &gsn_html_alignment_script_size },
                   { gsn_html_glass_script, &gsn_html_glass_script_size }
    };
    int r;

    gsn_report_text_raw(
        text, "<meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; "
              "img-src data:; style-src ");
    r = add_hash(text, gsn_html_style, gsn_html_style_size, err);
    if (scripts)
        gsn_report_text_raw(text, "; script-src");
    for (unsigned i = 0; r >= 0 && i < sizeof script / sizeof script[0]; i++)
        if (scripts >> i & 1U) {
            gsn_report_text_raw(text, " ");
            r = add_hash(text, script[i].bytes, *script[i].size, err);
        }
    gsn_report_text_raw(text, "; base-uri 'none'; form-action 'none'\">\n");
    return r;
}

int gsn_html_head(struct gsn_report_text *text, const char *name, const char *kind,
                  unsigned scripts, struct gsn_error *err)
{
    int r;

    gsn_report_text_raw(text,
                        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n");
    r = add_policy(text, scripts, err);
    if (r < 0)
        return r;
    gsn_report_text_raw(text,
                        "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n"
                        "<meta name=\"referrer\" content=\"no-referrer\">\n<title>");
    gsn_report_text_escape_short(text, name, 80);
    gsn_report_text_print(text, "%s \xC2\xB7 gieson</title>\n<style>", kind);
    gsn_report_text_bytes(text, gsn_html_style, gsn_html_style_size);
    gsn_report_text_raw(text, "</style>\n</head>\n<body>\n");
    return GSN_OK;
}

void gsn_html_figure(struct gsn_report_text *text, const char *before, double value, int decimals,
                     const char *behind)
{
    gsn_report_text_raw(text, before);
    gsn_report_text_number(text, value, decimals);
    gsn_report_text_raw(text, behind);
}

void gsn_html_run(struct gsn_report_text *text, const unsigned char *script, size_t size)
{
    gsn_report_text_raw(text, "<script>");
    gsn_report_text_bytes(text, script, size);
    gsn_report_text_raw(text, "</script>\n");
}

/* x and y of the block, then the residual's two parts, all in micrometres; empty: no such mark. */
void gsn_html_marks(struct gsn_report_text *text, const struct gsn_report_section *section)
{
    gsn_report_text_raw(text, " data-marks=\"");
    for (int i = 0; i < 3; i++) {
        const struct gsn_point *onto = &section->onto_um[i], *off = &section->off_um[i];

        if (i > 0)
            gsn_report_text_raw(text, ",");
        if (section->marker_found[i] && isfinite(onto->x) && isfinite(section->residual_um[i]))
            gsn_report_text_print(text, "%.1f %.1f %.3f %.3f", onto->x, onto->y, off->x, off->y);
    }
    gsn_report_text_raw(text, "\"");
}
