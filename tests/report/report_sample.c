/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* report_sample DIR: writes one made-up page of each kind there, as HTML and PDF, for looking at
 * and for test_pdf.py. */
#include <math.h>
#include <stdio.h>

#include "pipeline/core/file.h"
#include "tests/report/sample.h"

static int write_pdf(const char *folder, const char *name, const struct gsn_report *report,
                     struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(char) path = gsn_format("%s/%s.pdf", folder, name);
    size_t size = 0;
    int r = path ? gsn_report_pdf(report, &bytes, &size, err) : GSN_E_NOMEM;

    if (r >= 0)
        r = gsn_file_write(path, bytes, size, err);
    return r;
}

static int write_page(const char *folder, const char *name, const struct gsn_report *report,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) path = gsn_format("%s/%s.html", folder, name);
    size_t size = 0;
    int r = path ? gsn_report_html(report, &page, &size, err) : GSN_E_NOMEM;

    if (r >= 0)
        r = gsn_file_write(path, page, size, err);
    if (r >= 0)
        r = write_pdf(folder, name, report, err);
    return r;
}

static int write_glass(const char *folder, const struct gsn_report *report, struct gsn_error *err)
{
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) path = gsn_format("%s/" GSN_REPORT_GLASS_FILE, folder);
    size_t size = 0;
    int r = path ? gsn_report_glass_page(report, &page, &size, err) : GSN_E_NOMEM;

    return r < 0 ? r : gsn_file_write(path, page, size, err);
}

static int write_all(const char *folder, struct gsn_error *err)
{
    static const char *const name[] = { "specimen", "volume", "tile" };
    int r = GSN_OK;

    for (int kind = 0; kind < 3 && r >= 0; kind++) {
        struct sample *sample = sample_new((enum gsn_report_kind)kind, 420);

        if (!sample)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for a sample");
        r = write_page(folder, name[kind], sample_report(sample), err);
        if (r >= 0 && sample_report(sample)->glass)
            r = write_glass(folder, sample_report(sample), err);
        if (r >= 0 && kind == GSN_REPORT_SPECIMEN) {
            sample_report(sample)->verdict = GSN_REPORT_WITHHELD;
            sample_report(sample)->verdict_reason = "The evidence is too thin.";
            sample_report(sample)->loss_percent = (double)NAN;
            sample_report(sample)->loss_points = (double)NAN;
            sample_report(sample)->loss_reason =
                "Only 61 % of the region has data; at least 90 % is needed.";
            r = write_page(folder, "withheld", sample_report(sample), err);
        }
        sample_free(sample);
    }
    return r;
}

int main(int argc, char **argv)
{
    struct gsn_error err = { 0 };

    if (argc != 2) {
        (void)fprintf(stderr, "usage: report_sample DIR\n");
        return 2;
    }
    if (write_all(argv[1], &err) < 0) {
        (void)fprintf(stderr, "report_sample: %s\n", err.text);
        return 1;
    }
    return 0;
}
