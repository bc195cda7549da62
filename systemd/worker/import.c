/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Taking a folder into the store, as a scanner delivers it: job.json, the panels beside it, the
 * files the job names.
 *
 * Steps.
 * 1. Check before anything is written: keys, units, lengths that no laser, saw or microscope makes,
 * and that each named file is there. What can only be a mistake is refused.
 * 2. Specimen row; attachments and what a volume's header names, through the spool.
 * 3. Panels: every picture of the folder, when it is whole; a picture that changed under the reader
 * is tried again. Calibration panels are attachments too.
 * 4. Jobs for the panels and for the specimen.
 * 5. Notices: what will be withheld as things are, each with what would change that.
 * What cannot be taken (unreadable, a link, too large) is left out: the rest comes in, the import
 * ends as one that left something out, and a row of trouble names each, until an import finds it
 * taken or gone.
 *
 * How it fails: GSN_E_INPUT for a job to be corrected, before anything was written; GSN_E_BUSY for
 * a folder that still changes. Original bytes first, then rows, then jobs; the source is never
 * touched. */
#include "systemd/worker/import.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <limits.h>
#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "acquire/container.h"
#include "acquire/source.h"
#include "acquire/spool.h"
#include "pipeline/core/calendar.h"
#include "pipeline/core/file.h"
#include "pipeline/decode/volume.h"
#include "pipeline/specimen/drawn_region.h"
#include "pipeline/specimen/protocol.h"
#include "storage/audit_log.h"
#include "storage/bench.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/torn.h"

/* One folder while it is imported. */
struct import_work {
    const struct gsn_import *import;
    const struct gsn_protocol *protocol;
    struct gsn_spool *spool;
    int64_t specimen;
    struct gsn_import_counts counts;
    char **left; /* owned; paths of what was left out, as many as counted */
};

/* What is left out. */

/* The whole path of a file in the folder, for people who stand elsewhere. gives. */
static char *path_of(const struct gsn_import *import, const char *name)
{
    char whole[PATH_MAX];

    return gsn_format("%s/%s", realpath(import->dir, whole) ? whole : import->dir, name);
}

static int note_left(struct import_work *in, const char *path, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(path);
    char **more = copy ? gsn_realloc_array(in->left, in->counts.left_out + 1, sizeof *more) : NULL;

    if (!more)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    in->left = more;
    more[in->counts.left_out++] = gsn_steal(&copy);
    return GSN_OK;
}

/* what is left out, and what was once. */

/* Counts it, tells it, and puts its row unless a source does. Fails as the store does. */
static int leave_out(struct import_work *in, const char *name, const char *reason,
                     const char *action, struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of(in->import, name);
    gsn_auto_mem(char) next = gsn_format("%s; then import the folder again", action);
    const struct gsn_trouble_row row = {
        .source = GSN_IMPORT_SOURCE, .name = path, .reason = reason, .action = next
    };
    int r;

    if (!path || !next)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = note_left(in, path, err);
    if (r < 0)
        return r;
    if (in->import->left_out)
        in->import->left_out(in->import->context, name, reason, action);
    return in->import->served ? GSN_OK : gsn_trouble_put(in->import->store, &row, time(NULL), err);
}

static bool is_left(const struct import_work *in, const char *path)
{
    for (unsigned i = 0; i < in->counts.left_out; i++)
        if (strcmp(in->left[i], path) == 0)
            return true;
    return false;
}

/* Ends the trouble of what was left out once and is taken now or gone. Fails as the store does. */
static int forget_left(struct import_work *in, struct gsn_error *err)
{
    gsn_auto_mem(char) folder = path_of(in->import, "");
    gsn_auto(gsn_trouble_rows) rows = NULL;
    int r = folder ? gsn_trouble_list(in->import->store, &rows, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        const char *const path = rows->at[i].name;
        struct stat st;

        if (strcmp(rows->at[i].source, GSN_IMPORT_SOURCE) != 0)
            continue;
        if ((strncmp(path, folder, strlen(folder)) == 0 && !is_left(in, path)) ||
            (lstat(path, &st) < 0 && errno == ENOENT))
            r = gsn_trouble_clear(in->import->store, GSN_IMPORT_SOURCE, path, in->import->actor,
                                  time(NULL), err);
    }
    return r;
}

/* Checking: what can be told before anything is written. Refused is what can only be a mistake;
 * told is what will be withheld as things are. */

enum { MOST_HEADER_BYTES = 1 << 30, HEADER_BYTES = 65536 };

/* Lengths in micrometres beyond which a mistake is likelier than a specimen. Light resolves 0.2 um,
 * and a pixel of more than 100 um shows no mark (the largest burnt is 600 um across); a block is
 * 0.1 mm to 30 cm wide; a microtome cuts no thinner than 0.5 um. */
static const double FINEST_PX = 0.05, COARSEST_PX = 200;
static const double NARROWEST = 100, WIDEST = 3e5;
static const double THINNEST = 0.5;

/* The least region that holds a section's worth of pixels. */
static const double LEAST_REGION = 20;

static int refuse_unit(struct gsn_error *err, const char *key, const char *what, double value,
                       const char *unit, double factor)
{
    return gsn_fail(
        err, GSN_E_INPUT,
        "job.json: \"%s\" states %s of %.4g um; is that in %s? Lengths are micrometres: "
        "state %.6g",
        key, what, value, unit, value * factor);
}

static int check_keys(const struct gsn_protocol *p, struct gsn_error *err)
{
    if (!p->unknown)
        return GSN_OK;
    if (p->unknown_near && strcmp(p->unknown_near, "comment") == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: %s is no key; a note goes under \"comment\" or any key that "
                        "begins with it",
                        p->unknown);
    if (p->unknown_near)
        return gsn_fail(
            err, GSN_E_INPUT,
            "job.json: %s is no key: did you mean \"%s\"? man gieson-job lists all; notes go "
            "under \"comment\"",
            p->unknown, p->unknown_near);
    return gsn_fail(err, GSN_E_INPUT,
                    "job.json: %s is no key: man gieson-job lists all; notes go under \"comment\"",
                    p->unknown);
}

static int check_pixel(const struct gsn_protocol *p, struct gsn_error *err)
{
    if (p->px_um > 0 && p->px_um < FINEST_PX)
        return refuse_unit(err, "px_um", "pixels", p->px_um, "millimetres", 1000);
    if (p->px_um > COARSEST_PX)
        return refuse_unit(err, "px_um", "pixels", p->px_um, "nanometres", 0.001);
    if (p->interval_um < THINNEST)
        return refuse_unit(err, "interval_um", "sections", p->interval_um, "millimetres", 1000);
    return GSN_OK;
}

static int check_markers(const struct gsn_protocol *p, struct gsn_error *err)
{
    double longest = 0;

    if (!p->has_markers)
        return GSN_OK;
    for (int i = 0; i < 3; i++) {
        const struct gsn_point a = p->markers_um[i], b = p->markers_um[(i + 1) % 3];

        longest = fmax(longest, hypot(a.x - b.x, a.y - b.y));
    }
    if (longest < NARROWEST)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"markers_um\" states marks at most %.4g um apart; are they in "
                        "millimetres? Lengths are micrometres: multiply them by 1000",
                        longest);
    if (longest > WIDEST)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"markers_um\" states marks %.4g um apart; are they in "
                        "nanometres? Lengths are micrometres: divide them by 1000",
                        longest);
    return GSN_OK;
}

/* key: what job.json calls it. */
static int check_region(const struct gsn_protocol *p, const struct gsn_region *region,
                        const char *key, struct gsn_error *err)
{
    double size = INFINITY;

    if (region->kind == GSN_REGION_BOX)
        size = fmax(region->high.x - region->low.x, region->high.y - region->low.y);
    if (region->kind == GSN_REGION_CYLINDER || region->kind == GSN_REGION_SPHERE)
        size = 2 * region->radius_um;
    if (p->kind == GSN_KIND_SECTIONS && size < LEAST_REGION)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"%s\" is %.4g um wide; is it in millimetres? Lengths are "
                        "micrometres: multiply them by 1000",
                        key, size);
    return GSN_OK;
}

/* Of a volume, or of a mask: its header must say its unit, or the job. */
static int check_unit(const struct gsn_import *import, const struct gsn_protocol *p,
                      const char *file, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_fd fd = -1;
    size_t size = 0;
    int r;

    if (p->spacing_unit != GSN_SPACING_UNSAID)
        return GSN_OK;
    r = gsn_file_open_in(import->dir, file, &fd, err);
    if (r >= 0)
        r = gsn_file_read_open(fd, file, MOST_HEADER_BYTES, &bytes, &size, err);
    if (r < 0)
        return r;
    if (gsn_volume_states_unit((const char *)bytes, size < HEADER_BYTES ? size : HEADER_BYTES))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "%s does not say in what its spacing is: ITK and Slicer write millimetres. Say "
                    "--spacing-unit mm or um (in a job.json \"spacing_unit\")",
                    file);
}

/* what can be told before anything is written. */

/* Keys, units and plausible lengths. Fails with GSN_E_INPUT, and as reading a header does. */
static int check_job(const struct gsn_import *import, const struct gsn_protocol *p,
                     struct gsn_error *err)
{
    int r = check_keys(p, err);

    if (r >= 0)
        r = check_pixel(p, err);
    if (r >= 0)
        r = check_markers(p, err);
    if (r >= 0)
        r = check_region(p, &p->region, "region", err);
    for (size_t i = 0; r >= 0 && i < p->named_count; i++)
        r = check_region(p, &p->named[i].region, p->named[i].name, err);
    if (r >= 0 && p->kind == GSN_KIND_VOLUME)
        r = check_unit(import, p, p->file, err);
    return r;
}

/* ---- what will be withheld ---------------------------------------------------------------- */

static void note_withheld(const struct import_work *in, const char *sentence)
{
    if (in->import->notice)
        in->import->notice(in->import->context, "job.json", sentence);
}

static int note_baseline(const struct import_work *in, struct gsn_error *err)
{
    const struct gsn_protocol *p = in->protocol;
    gsn_auto(gsn_specimen_rows) rows = NULL;
    char sentence[400];
    int r;

    if (!p->baseline[0])
        return GSN_OK;
    r = gsn_specimen_baseline(in->import->store, p->study, p->baseline, &rows, err);
    if (r < 0)
        return r;
    if (rows->count == 0) {
        (void)snprintf(sentence, sizeof sentence,
                       "no specimen or group \"%.200s\" is in the store%s%.60s%s: the loss waits "
                       "until its panels are imported",
                       p->baseline, p->study[0] ? " in study \"" : "", p->study,
                       p->study[0] ? "\"" : "");
        note_withheld(in, sentence);
    }
    if (p->calibration_count == 0)
        note_withheld(
            in, "no \"calibration\" is stated: the loss will have a wide interval or be withheld; "
                "a calibration panel of the batch narrows it");
    return GSN_OK;
}

/* What will be withheld, and which panels are missing, as notices. Fails as the store does. */
static int note_job(const struct import_work *in, struct gsn_error *err)
{
    const struct gsn_protocol *p = in->protocol;
    gsn_auto(gsn_panel_rows) panels = NULL;
    char sentence[200];
    int r;

    if (p->kind != GSN_KIND_SECTIONS)
        return GSN_OK;
    r = gsn_panel_list(in->import->store, in->specimen, &panels, err);
    if (r < 0)
        return r;
    if (panels->count == 0)
        note_withheld(
            in, "no panel lies beside it: copy the scans into this folder and import it again");
    else if (p->panels > 0 && panels->count != p->panels) {
        (void)snprintf(sentence, sizeof sentence, "it states %u panel%s, %zu %s here: %s",
                       p->panels, p->panels == 1 ? "" : "s", panels->count,
                       panels->count == 1 ? "is" : "are",
                       panels->count < p->panels
                           ? "import the rest, or say which are lost with `gieson decide`"
                           : "take the others out of the folder, or put \"panels\" right");
        note_withheld(in, sentence);
    }
    if (p->region.kind == GSN_REGION_NONE)
        note_withheld(in, "no \"region\" is stated: the figures will be withheld");
    else if (!p->has_markers && p->region.kind != GSN_REGION_BAND)
        note_withheld(
            in, "\"region\" is stated and \"markers_um\" is not: nobody knows where it lies in the "
                "block, so the figures will be withheld");
    return note_baseline(in, err);
}

/* Files that the job names. */

/* A name that stays in the folder: the job must not reach elsewhere. */
static int check_name(const char *name, struct gsn_error *err)
{
    if (!name[0] || strchr(name, '/') || name[0] == '.')
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json names \"%s\": a file must lie beside job.json, without folders",
                        name);
    return GSN_OK;
}

static int check_file(const struct gsn_import *import, const char *name, struct gsn_error *err)
{
    gsn_auto_fd fd = -1;
    struct gsn_error why = { 0 };
    int r = check_name(name, err);

    if (r < 0)
        return r;
    r = gsn_file_open_in(import->dir, name, &fd, &why);
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, GSN_E_INPUT, "job.json names \"%s\": there is no such file in %s",
                        name, import->dir);
    return r < 0 ? gsn_fail(err, r, "job.json names \"%s\": %.300s", name, why.text) : GSN_OK;
}

/* Outlines that cannot be a region are told before anything is written; where they lie is too. */
static int check_outlines(const struct gsn_import *import, const struct gsn_region *region,
                          struct gsn_error *err)
{
    char said[GSN_DRAWN_SENTENCE], sentence[GSN_DRAWN_SENTENCE + 120];
    gsn_auto(gsn_mask) mask = NULL;
    gsn_auto_mem(uint8_t) text = NULL;
    gsn_auto_fd fd = -1;
    size_t size = 0;
    int r;

    if (region->kind != GSN_REGION_DRAWN)
        return GSN_OK;
    r = gsn_file_open_in(import->dir, region->file, &fd, err);
    if (r >= 0)
        r = gsn_file_read_open(fd, region->file, GSN_DRAWN_MOST_BYTES, &text, &size, err);
    if (r >= 0)
        r = gsn_drawn_region_read(region, (const char *)text, size, &mask, said, err);
    if (r < 0)
        return r;
    (void)snprintf(sentence, sizeof sentence, "the region of %.80s: %s", region->file, said);
    if (import->notice)
        import->notice(import->context, "job.json", sentence);
    return GSN_OK;
}

static int check_region_file(const struct gsn_import *import, const struct gsn_region *region,
                             struct gsn_error *err)
{
    const int r = region->file ? check_file(import, region->file, err) : GSN_OK;

    return r < 0 ? r : check_outlines(import, region, err);
}

/* the files that the job names. */

/* Before anything is written: a job that must be corrected leaves no specimen of its name. Fails
 * with GSN_E_INPUT, GSN_E_NOMEM. */
static int check_files(const struct gsn_import *import, const struct gsn_protocol *protocol,
                       struct gsn_error *err)
{
    const char *const names[] = {
        protocol->kind == GSN_KIND_SECTIONS ? NULL : protocol->file,
        protocol->reference[0] ? protocol->reference : NULL,
    };

    int r = check_region_file(import, &protocol->region, err);

    for (size_t i = 0; r >= 0 && i < sizeof names / sizeof names[0]; i++)
        r = names[i] ? check_file(import, names[i], err) : GSN_OK;
    for (size_t i = 0; r >= 0 && i < protocol->named_count; i++)
        r = check_region_file(import, &protocol->named[i].region, err);
    for (size_t i = 0; r >= 0 && i < protocol->calibration_count; i++)
        r = check_file(import, protocol->calibration[i].file, err);
    return r;
}

/* What rests on an attachment is asked for together with its change. */
static int log_attachment(struct import_work *in, const struct gsn_attachment_row *row,
                          struct gsn_error *err)
{
    int64_t job = 0;
    int again = 0, r = gsn_store_begin(in->import->store, err);

    if (r < 0)
        return r;
    r = gsn_attachment_put(in->import->store, in->specimen, row, &again, err);
    if (r >= 0 && !again)
        r = gsn_queue_add(in->import->store, in->specimen, 0, &job, err);
    if (r < 0) {
        gsn_store_rollback(in->import->store);
        return r;
    }
    return gsn_store_commit(in->import->store, err);
}

static int attach_one(struct import_work *in, const char *name, uint8_t **ret_bytes,
                      size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_fd fd = -1;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_spooled spooled;
    size_t size;
    int r = check_name(name, err);

    if (r >= 0)
        r = gsn_file_open_in(in->import->dir, name, &fd, err);
    if (r >= 0)
        r = gsn_file_read_open(fd, name, GSN_SPOOL_MOST_BYTES, &bytes, &size, err);
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, GSN_E_INPUT, "a header names \"%s\": there is no such file in %s",
                        name, in->import->dir);
    if (r >= 0)
        r = gsn_spool_take(in->spool, bytes, size, name, &spooled, err);
    if (r >= 0) {
        const struct gsn_attachment_row row = { .name = name,
                                                .sha256 = spooled.digest.hex,
                                                .size = (int64_t)size };

        r = log_attachment(in, &row, err);
    }
    if (r < 0)
        return r;
    in->counts.attached++;
    if (ret_bytes) {
        *ret_bytes = gsn_steal(&bytes);
        *ret_size = size;
    }
    return GSN_OK;
}

/* The value of "key = value" or "key: value" in a volume's header, or NULL. gives. */
static char *header_value(const char *text, size_t size, const char *key)
{
    const char *end = text + (size > 65536 ? 65536 : size);
    const size_t key_length = strlen(key);

    for (const char *line = text; line < end;) {
        const char *stop = memchr(line, '\n', (size_t)(end - line));
        const char *at = line + key_length;

        stop = stop ? stop : end;
        if (stop - line > (ptrdiff_t)key_length && strncmp(line, key, key_length) == 0) {
            while (at < stop && strchr(" \t=:", *at))
                at++;
            while (stop > at && isspace((unsigned char)stop[-1]))
                stop--;
            return gsn_format("%.*s", (int)(stop - at), at);
        }
        line = stop + 1;
    }
    return NULL;
}

/* A mask or volume, and the file its header keeps the voxels in. */
static int attach_volume(struct import_work *in, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(char) data = NULL;
    size_t size;
    int r = attach_one(in, name, &bytes, &size, err);

    if (r < 0)
        return r;
    data = header_value((const char *)bytes, size, "ElementDataFile");
    if (!data)
        data = header_value((const char *)bytes, size, "data file");
    if (!data || strcmp(data, "LOCAL") == 0)
        return GSN_OK;
    return attach_one(in, data, NULL, NULL, err);
}

/* The file that a region names, if it does. */
static int attach_region(struct import_work *in, const struct gsn_region *region,
                         struct gsn_error *err)
{
    if (!region->file)
        return GSN_OK;
    return region->kind == GSN_REGION_DRAWN ? attach_one(in, region->file, NULL, NULL, err)
                                            : attach_volume(in, region->file, err);
}

/* Each of them, and what the header of a volume names, into the spool and the store. Fails with
 * GSN_E_INPUT, and as the spool and the store do. */
static int attach_files(struct import_work *in, const struct gsn_protocol *protocol,
                        struct gsn_error *err)
{
    int r = attach_region(in, &protocol->region, err);

    for (size_t i = 0; r >= 0 && i < protocol->named_count; i++)
        r = attach_region(in, &protocol->named[i].region, err);
    if (r >= 0 && protocol->kind == GSN_KIND_VOLUME)
        r = attach_volume(in, protocol->file, err);
    if (r >= 0 && protocol->kind == GSN_KIND_TILE)
        r = attach_one(in, protocol->file, NULL, NULL, err);
    if (r >= 0 && protocol->reference[0])
        r = attach_one(in, protocol->reference, NULL, NULL, err);
    for (size_t i = 0; r >= 0 && i < protocol->calibration_count; i++)
        r = attach_one(in, protocol->calibration[i].file, NULL, NULL, err);
    return r;
}

enum {
    SETTLE_MS = 150, /* two looks at the folder, this far apart, must agree */
    MOST_LOOKS = 100,
};

/* Panels. */

static void emit_notice(const struct gsn_import *import, const char *name, const char *sentence)
{
    if (import->notice)
        import->notice(import->context, name, sentence);
}

/* Held panels are looked at again: the one that stood in their way may have a new name. */
static int release_held(struct import_work *in, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) rows = NULL;
    int r = gsn_panel_list(in->import->store, in->specimen, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        int64_t job;

        if (strcmp(rows->at[i].state, "held") != 0)
            continue;
        r = gsn_panel_set_state(in->import->store, rows->at[i].id, "waiting", NULL, NULL, err);
        if (r >= 0)
            r = gsn_queue_add(in->import->store, in->specimen, rows->at[i].id, &job, err);
    }
    return r;
}

/* Bytes that are known under another name: a held panel takes the new one, which is how a person
 * answers what it was held for. */
static int rename_panel(struct import_work *in, int64_t panel, const struct gsn_panel_row *now,
                        struct gsn_error *err)
{
    gsn_auto(gsn_panel_row) was = NULL;
    int r = gsn_panel_get(in->import->store, panel, &was, err);

    if (r < 0 || strcmp(was->state, "held") != 0 || strcmp(was->file_name, now->file_name) == 0)
        return r;
    r = gsn_panel_set_name(in->import->store, panel, now->number, now->file_name, err);
    if (r >= 0)
        r = gsn_event_add(in->import->store, time(NULL), in->import->actor, "rename",
                          now->file_name, was->file_name, err);
    return r < 0 ? r : release_held(in, err);
}

static int log_panel(struct import_work *in, const struct gsn_source_event *item,
                     const struct gsn_spooled *spooled, struct gsn_error *err)
{
    const unsigned number = gsn_panel_number(item->name, 0);
    const struct gsn_panel_row row = { .specimen_id = in->specimen,
                                       .number = number,
                                       .file_name = item->name,
                                       .sha256 = spooled->digest.hex,
                                       .size = (int64_t)spooled->size,
                                       .state = "waiting",
                                       .code = "",
                                       .message = "",
                                       .px_um = NAN };
    int64_t panel = 0, job, mended = 0;
    int again = 0, r;

    r = gsn_store_begin(in->import->store, err);
    if (r < 0)
        return r;
    r = gsn_torn_replace(in->import->store, &row, time(NULL), in->import->actor, &mended, err);
    if (r >= 0 && !mended)
        r = gsn_panel_put(in->import->store, &row, &panel, &again, err);
    if (r >= 0 && again)
        r = rename_panel(in, panel, &row, err);
    if (r >= 0 && !again && !mended)
        r = gsn_queue_add(in->import->store, in->specimen, panel, &job, err);
    if (r >= 0 && !again)
        r = gsn_event_add(in->import->store, time(NULL), in->import->actor, "panel", item->name,
                          spooled->digest.hex, err);
    if (r < 0) {
        gsn_store_rollback(in->import->store);
        return r;
    }
    r = gsn_store_commit(in->import->store, err);
    if (r < 0)
        return r;
    if (again) {
        in->counts.again++;
        emit_notice(in->import, item->name, "the same bytes are in the store already");
    } else {
        if (mended)
            emit_notice(
                in->import, item->name,
                "what came under this name before was a torn beginning of it; both are kept");
        in->counts.taken++;
        if (number == 0) {
            in->counts.held++;
            emit_notice(in->import, item->name, "its name holds no panel number");
        }
    }
    return GSN_OK;
}

/* It lies beside the panels and is none. */
static int is_calibration(const struct gsn_protocol *protocol, const char *name)
{
    for (size_t i = 0; i < protocol->calibration_count; i++)
        if (strcmp(protocol->calibration[i].file, name) == 0)
            return 1;
    return 0;
}

static int take_item(struct import_work *in, struct gsn_source *source,
                     const struct gsn_source_event *item, struct gsn_error *err)
{
    struct gsn_spooled spooled;
    struct gsn_error why = { 0 };
    int r;

    if (is_calibration(in->protocol, item->name))
        return gsn_source_acknowledge(source, item->item, err);
    if (gsn_spool_check_size(item->size, item->name, &why) < 0) {
        r = leave_out(in, item->name, why.text, "take it out of the folder", err);
        return r < 0 ? r : gsn_source_acknowledge(source, item->item, err);
    }
    if (item->incomplete)
        emit_notice(in->import, item->name, item->reason);
    r = gsn_spool_take_item(in->spool, source, item, &spooled, err);
    /* An empty file cannot become an object; it is named and left where it is. */
    if (r == GSN_E_INPUT && item->size == 0) {
        emit_notice(in->import, item->name, "the file is empty");
        return gsn_source_acknowledge(source, item->item, err);
    }
    if (r >= 0)
        r = log_panel(in, item, &spooled, err);
    return r < 0 ? r : gsn_source_acknowledge(source, item->item, err);
}

/* all pictures of the folder become panels. Fails with GSN_E_BUSY when the folder
 * keeps changing, and as the source, the spool and the store do. */
static int take_panels(struct import_work *in, struct gsn_error *err)
{
    const struct gsn_source_options options = { .settle_ms = SETTLE_MS, .patience_ms = SETTLE_MS };
    const struct timespec pause = { .tv_nsec = (SETTLE_MS + 20) * 1000000L };
    gsn_auto_mem(char) address = gsn_format("replay:%s", in->import->dir);
    gsn_auto(gsn_source) source = NULL;
    int ended = 0;
    int r;

    if (!address)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = gsn_source_open(address, &options, &source, err);
    for (int look = 0; r >= 0 && !ended && look < MOST_LOOKS; look++) {
        gsn_auto(gsn_source_events) events = NULL;

        if (look > 0)
            (void)nanosleep(&pause, NULL);
        r = gsn_source_poll(source, gsn_now_ms(), &events, &ended, err);
        for (size_t i = 0; r >= 0 && i < events->count; i++) {
            const struct gsn_source_event *event = &events->at[i];

            if (event->what == GSN_SOURCE_READY)
                r = take_item(in, source, event, err);
            else if (event->what == GSN_SOURCE_BARRED && ended)
                r = leave_out(in, event->name, event->reason, event->action, err);
        }
    }
    if (r >= 0 && !ended)
        return gsn_fail(err, GSN_E_BUSY, "%s keeps changing: import it when the copy is done",
                        in->import->dir);
    return r;
}

enum { MOST_JOB_BYTES = 1 << 20 };

/* Space that must stay free, so that the database can always finish what it began. */
static const uint64_t RESERVE_BYTES = (uint64_t)64 << 20;

/* The import. */

static int put_specimen(struct import_work *in, const struct gsn_protocol *protocol,
                        const char *text, struct gsn_error *err)
{
    static const char *const kinds[] = { "sections", "volume", "tile" };
    const struct gsn_specimen_row row = { .name = protocol->specimen,
                                          .study = protocol->study,
                                          .group = protocol->group,
                                          .animal = protocol->animal,
                                          .week = protocol->week,
                                          .kind = kinds[protocol->kind],
                                          .baseline = protocol->baseline,
                                          .job_json = text,
                                          .job_sha256 = "" };

    return gsn_specimen_put(in->import->store, &row,
                            in->import->replace ? GSN_SPECIMEN_REPLACE : GSN_SPECIMEN_REFUSE,
                            in->import->actor, time(NULL), &in->specimen, err);
}

/* New settings can change what is found on every panel that came before. */
static int ask_again(struct import_work *in, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    int64_t job;
    int r = gsn_panel_list(in->import->store, in->specimen, &panels, err);

    for (size_t i = 0; r >= 0 && i < panels->count; i++)
        r = gsn_queue_add(in->import->store, in->specimen, panels->at[i].id, &job, err);
    return r;
}

/* Panels and attachments that are new have asked for it; importing a folder again in which nothing
 * is new must not. */
static int ask_for_report(struct import_work *in, struct gsn_error *err)
{
    int64_t job;

    if (in->import->replace)
        return gsn_queue_add(in->import->store, in->specimen, 0, &job, err);
    return gsn_queue_add_first(in->import->store, in->specimen, err);
}

static int take_everything(struct import_work *in, const struct gsn_protocol *protocol,
                           const char *text, struct gsn_error *err)
{
    int r = check_files(in->import, protocol, err);

    in->protocol = protocol;
    if (r >= 0)
        r = check_job(in->import, protocol, err);
    if (r >= 0)
        r = put_specimen(in, protocol, text, err);
    if (r >= 0 && in->import->replace)
        r = ask_again(in, err);
    if (r >= 0)
        r = attach_files(in, protocol, err);
    if (r >= 0 && protocol->kind == GSN_KIND_SECTIONS)
        r = take_panels(in, err);
    if (r >= 0)
        r = forget_left(in, err);
    if (r >= 0)
        r = ask_for_report(in, err);
    return r >= 0 ? note_job(in, err) : r;
}

static void work_done(struct import_work *in)
{
    for (unsigned i = 0; i < in->counts.left_out; i++)
        gsn_free(in->left[i]);
    gsn_free(in->left);
}

int gsn_import_folder(const struct gsn_import *import, char **ret_specimen,
                      struct gsn_import_counts *ret_counts, struct gsn_error *err)
{
    __attribute__((cleanup(work_done))) struct import_work in = { .import = import };
    gsn_auto(gsn_spool) spool = NULL;
    gsn_auto(gsn_protocol) protocol = NULL;
    gsn_auto_mem(uint8_t) file = NULL;
    gsn_auto_mem(char) name = NULL;
    const char *text = import->job_text;
    size_t size = text ? strlen(text) : 0;
    int r = GSN_OK;

    if (!text) {
        gsn_auto_fd fd = -1;

        r = gsn_file_open_in(import->dir, "job.json", &fd, err);
        if (r >= 0)
            r = gsn_file_read_open(fd, "job.json", MOST_JOB_BYTES, &file, &size, err);
        text = (const char *)file;
    }
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(
            err, r,
            access(import->dir, F_OK) < 0
                ? "there is no folder %s"
                : "%s has no job.json: it says whose sections these are (see man gieson-job)",
            import->dir);
    if (r >= 0)
        r = gsn_protocol_parse(text, size, &protocol, err);
    if (r >= 0)
        r = gsn_spool_open(gsn_store_dir(import->store), RESERVE_BYTES, &spool, err);
    if (r < 0)
        return r;
    in.spool = spool;
    name = gsn_strdup(protocol->specimen);
    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = take_everything(&in, protocol, text, err);
    if (r < 0)
        return r;
    *ret_specimen = gsn_steal(&name);
    *ret_counts = in.counts;
    return GSN_OK;
}
