/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What every page of ours is made of: its head with the policy of what may run, pictures inside the
 * file, units as people write them. */
#ifndef GSN_REPORT_HTML_ELEMENTS_H
#define GSN_REPORT_HTML_ELEMENTS_H

#include "pipeline/report/report.h"
#include "pipeline/report/text.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The style sheet; its hash is what the page's security policy allows. */
extern const unsigned char gsn_html_style[];
extern const size_t gsn_html_style_size;

/* viewer.js, alignment.js and glass.js, likewise. */
extern const unsigned char gsn_html_viewer_script[];
extern const size_t gsn_html_viewer_script_size;
extern const unsigned char gsn_html_alignment_script[];
extern const size_t gsn_html_alignment_script_size;
extern const unsigned char gsn_html_glass_script[];
extern const size_t gsn_html_glass_script_size;

/* Which of them a page has, as bits. */
enum { GSN_HTML_MODEL = 1, GSN_HTML_ALIGNMENT = 2, GSN_HTML_GLASS = 4 };

/* Everything up to and with <body>: the policy that nothing is fetched and that nothing runs but
 * these scripts; the title (somebody's text, then ours), the style sheet. Fails with GSN_E_NOMEM.
 */
int gsn_html_head(struct gsn_report_text *text, const char *name, const char *kind,
                  unsigned scripts, struct gsn_error *err);

/* Whether there is a text to show. */
static inline int gsn_html_is_said(const char *text)
{
    return text && *text;
}

/* <img> with the picture as a data: URI. */
void gsn_html_image(struct gsn_report_text *text, const struct gsn_report_png *png,
                    const char *said);
/* A script of ours, where the page's policy allows it. */
void gsn_html_run(struct gsn_report_text *text, const unsigned char *script, size_t size);
/* What the viewers ask of a mark: its place and residual, um, empty where it was not found. */
void gsn_html_marks(struct gsn_report_text *text, const struct gsn_report_section *section);
/* A unit as people write it: mm3 becomes mm with a raised 3. */
void gsn_html_unit(struct gsn_report_text *text, const char *unit);
/* A number of so many decimals within a sentence of ours. */
void gsn_html_figure(struct gsn_report_text *text, const char *before, double value, int decimals,
                     const char *behind);

#ifdef __cplusplus
}
#endif
#endif
