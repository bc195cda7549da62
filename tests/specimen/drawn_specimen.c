/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/specimen/drawn_specimen.h"

#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/memory_file.h"

#include <stdio.h>
#include <string.h>

static int open_png(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    const struct drawn_specimen *d = context;

    for (size_t i = 0; i < d->count; i++)
        if (strcmp(d->sha256[i], sha256) == 0)
            return gsn_memory_file(d->png[i], d->panel[i].size, ret_fd, err);
    return gsn_fail(err, GSN_E_NOTFOUND, "there is no object %s", sha256);
}

struct gsn_protocol *drawn_protocol(const char *job)
{
    struct gsn_protocol *protocol = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_protocol_parse(job, strlen(job), &protocol, &err), err);
    return protocol;
}

static void add_panel(struct drawn_specimen *d, const struct drawn_panel *drawn)
{
    const size_t i = d->count++;
    struct gsn_error err = { 0 };
    size_t size;

    d->png[i] = drawn_panel_png(drawn, &size);
    (void)snprintf(d->sha256[i], sizeof d->sha256[i], "%064zx", i + 1);
    (void)snprintf(d->file[i], sizeof d->file[i], "P%02zu.png", i + 1);
    CHECK_OK(gsn_panel_analyse(NULL, gsn_check_fd(d->png[i], size), d->protocol, (unsigned)i + 1,
                               NULL, 1, NULL, &d->findings[i], &err),
             err);
    d->panel[i] = (struct gsn_specimen_panel){ .number = (unsigned)i + 1,
                                               .file = d->file[i],
                                               .sha256 = d->sha256[i],
                                               .state = "registered",
                                               .message = "",
                                               .size = size,
                                               .px_um = d->findings[i]->px_um,
                                               .upright = d->findings[i]->upright,
                                               .section_count = d->findings[i]->count,
                                               .section = d->findings[i]->section };
    d->input[i] = (struct gsn_specimen_input){ d->file[i], d->sha256[i], size };
}

void drawn_specimen_init(struct drawn_specimen *d, const char *job,
                         const struct drawn_panel *panels, size_t count)
{
    *d = (struct drawn_specimen){ .protocol = drawn_protocol(job) };
    CHECK(count <= DRAWN_PANELS);
    for (size_t i = 0; i < count; i++)
        add_panel(d, &panels[i]);
    d->specimen = (struct gsn_specimen){
        .protocol = d->protocol,
        .panel_count = count,
        .panel = d->panel,
        .baseline = { .name = d->protocol->baseline, .definition = "", .dyes = "" },
        .input_count = count,
        .input = d->input,
        .key = "0123456789abcdef",
        .open = open_png,
        .context = d
    };
}

void drawn_specimen_even(struct drawn_specimen *d, const char *job, double density)
{
    struct drawn_panel panels[3];

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, density);
    drawn_specimen_init(d, job, panels, 3);
}

void drawn_specimen_done(struct drawn_specimen *d)
{
    for (size_t i = 0; i < d->count; i++) {
        gsn_panel_findings_free(d->findings[i]);
        gsn_free(d->png[i]);
    }
    gsn_protocol_free(d->protocol);
}
