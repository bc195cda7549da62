/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-work: the heavy program. It does one thing and ends, so that a crash in mathematics or in
 * a decoder costs one job and never a scan. `gieson` and giesond start it; people rarely do.
 *
 *     gieson-work --store DIR import FOLDER 77: some files were left out
 *     gieson-work --store DIR work          claims one job; 0: done, 66: nothing to do, 75: busy
 *     gieson-work --store DIR verify RUN
 *     gieson-work --store DIR changed       asks for the job of every specimen that changed
 *     gieson-work --store DIR scrub         looks the store over; 65: something is damaged
 *     gieson-work --store DIR backup TO     copies the store, verified
 *     gieson-work --store DIR restore FROM  makes the store from such a copy
 *     gieson-work check FILE...             decodes strictly, says what each file is
 *     gieson-work register FOLDER           the poses of a folder of section pictures
 *     gieson-work --store DIR study [NAME]  makes the page of a study, or of all
 *     gieson-work plan                      how many animals a difference needs
 *     gieson-work --store DIR export SPECIMEN FILE        the model for other programs
 *     gieson-work --store DIR render SPECIMEN... FILE.png a picture of the model
 *     gieson-work --store DIR probe SPECIMEN X Y Z        the model at a point,
 *     gieson-work --store DIR line SPECIMEN X1 ... Z2     along a segment,
 *     gieson-work --store DIR index         the front page of the store
 *     gieson-work --store DIR integral SPECIMEN           over a region, a box, a plane
 */

#include <argp.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>

#include "pipeline/core/mem.h"
#include "systemd/worker/work_verbs.h"

enum { MOST_THREADS = 64, MOST_MINUTES = 10000 };

const char *argp_program_version = "gieson-work " GSN_VERSION;

enum {
    OPT_VOLUME = 256,
    OPT_TILE,
    OPT_REFERENCE,
    OPT_SPECIMEN,
    OPT_THRESHOLD,
    OPT_SPACING_UNIT,
    OPT_REPLACE,
    OPT_SERVED,
    OPT_MINUTES,
    OPT_QUICK,
    OPT_JOURNAL,
    OPT_MARKS,
    OPT_PX_UM,
    OPT_RADIUS,
    OPT_BY_TISSUE,
    OPT_CSV,
    OPT_QUIET,
    OPT_BECAUSE,
    OPT_DIFFERENCE,
    OPT_SD,
    OPT_POWER,
    OPT_LEVEL,
    OPT_STEP,
    OPT_WHOLE,
    OPT_BOX,
    OPT_PLANE,
    OPT_TRANSLUCENT,
    OPT_TRUE_COLOUR,
    OPT_SURFACE,
    OPT_CELLS,
    OPT_VIEW,
    OPT_SIZE,
    OPT_WINDOW,
    OPT_PERSPECTIVE,
    OPT_PREVIEW,
    OPT_POINTS,
    OPT_PUBLISH
};

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE)", 0 },
    { "threads", 't', "N", 0, "Threads to use (default: as many as there are processors)", 0 },
    { "json", 'j', NULL, 0, "Print JSON", 0 },
    { "replace", OPT_REPLACE, NULL, 0, "import: a specimen of the same name takes the new job", 1 },
    { "served", OPT_SERVED, NULL, OPTION_HIDDEN, "import: by giesond, which looks into the folder",
      1 },
    { "volume", OPT_VOLUME, "FILE", 0, "import: a volume (.mhd, .nrrd, .inr) instead of a folder",
      1 },
    { "tile", OPT_TILE, "FILE", 0, "import: one picture of stained tissue", 1 },
    { "reference", OPT_REFERENCE, "FILE", 0, "import --tile: a mask to compare with, beside it",
      1 },
    { "specimen", OPT_SPECIMEN, "NAME", 0, "import --volume, --tile: its name", 1 },
    { "threshold", OPT_THRESHOLD, "X", 0, "import --volume, --tile: may be given up to 8 times",
      1 },
    { "spacing-unit", OPT_SPACING_UNIT, "UNIT", 0,
      "import --volume: mm or um, where its header does not say", 1 },
    { "minutes", OPT_MINUTES, "N", 0, "scrub: stop after so long; the next one goes on there", 1 },
    { "quick", OPT_QUICK, NULL, 0, "scrub: all but the bytes of the originals", 1 },
    { "journal", OPT_JOURNAL, "FILE", 0,
      "verify, scrub: lines of the system's journal that say where the audit log ended (-: stdin)",
      1 },
    { "marks", OPT_MARKS, "X,Y X,Y X,Y", 0, "register: where the marks are in the frame wanted",
      1 },
    { "px-um", OPT_PX_UM, "UM", 0, "register: size of a pixel; without it lengths are pixels", 1 },
    { "radius", OPT_RADIUS, "R", 0, "register: the error is given over this disc", 1 },
    { "by-tissue", OPT_BY_TISSUE, NULL, 0,
      "register: lay sections without marks by the tissue of their neighbours", 1 },
    { "csv", OPT_CSV, NULL, 0, "study: print a row an animal and measure", 1 },
    { "quiet", OPT_QUIET, NULL, 0, "study: write the files and print nothing", 1 },
    { "because", OPT_BECAUSE, "TEXT", 0, "study NAME exclude SPECIMEN: why", 1 },
    { "publish", OPT_PUBLISH, "FOLDER", 0, "index: copy all pages there", 1 },
    { "difference", OPT_DIFFERENCE, "POINTS", 0, "plan: of losses, to be found", 1 },
    { "sd", OPT_SD, "POINTS", 0, "plan: what losses of animals differ by", 1 },
    { "power", OPT_POWER, "P", 0, "plan: how surely it is to be found (default 0.8)", 1 },
    { "level", OPT_LEVEL, "V", 0, "export: of a surface; integral: may be given up to 8 times", 1 },
    { "step", OPT_STEP, "UM", 0, "export: size of a volume's voxels, of a surface's edges", 1 },
    { "whole", OPT_WHOLE, NULL, 0, "export, render, integral: the whole domain, not the region",
      1 },
    { "box", OPT_BOX, "X1,Y1,Z1,X2,Y2,Z2", 0,
      "integral: over the region in a box; render: what of it is shown", 1 },
    { "plane", OPT_PLANE, "X,Y,Z,NX,NY,NZ", 0,
      "integral: over the region on a plane; render: the normal's side is cut away", 1 },
    { "translucent", OPT_TRANSLUCENT, NULL, 0, "render: emission and absorption", 1 },
    { "true-colour", OPT_TRUE_COLOUR, NULL, 0, "render: in the colours of the sections", 1 },
    { "surface", OPT_SURFACE, "V", 0, "render: where the density is V", 1 },
    { "cells", OPT_CELLS, "PERCENT", 0, "render: cells apart, of that size", 1 },
    { "view", OPT_VIEW, "X,Y,Z", 0, "render: x, y, z, corner, or a direction into the block", 1 },
    { "size", OPT_SIZE, "PX", 0, "render: width and height (default 640)", 1 },
    { "window", OPT_WINDOW, "LOW,HIGH", 0, "render: densities of the colour scale", 1 },
    { "perspective", OPT_PERSPECTIVE, NULL, 0, "render: seen by an eye", 1 },
    { "preview", OPT_PREVIEW, NULL, 0, "render: quickly, by cells instead of rays", 1 },
    { "points", OPT_POINTS, "N", 0, "line: of the profile (default: 33)", 1 },
    { 0 },
};

/* The command line. */

static unsigned take_whole(const char *text, const char *option, unsigned most,
                           struct argp_state *state)
{
    json_t *number = gsn_work_number(text);
    const json_int_t value = json_is_integer(number) ? json_integer_value(number) : -1;

    json_decref(number);
    if (value < 0 || value > most)
        argp_error(state, "--%s must be a whole number from 0 to %u", option, most);
    return (unsigned)value;
}

/* One more number of an option that may be given again. */
static void take_number(const char *text, const char *option, json_t **list,
                        struct argp_state *state)
{
    json_t *number = gsn_work_number(text);

    if (!json_is_number(number))
        argp_error(state, "--%s must be a number, not \"%s\"", option, text);
    if (!*list)
        *list = json_array();
    (void)json_array_append_new(*list, number);
}

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct gsn_work_request *request = state->input;

    switch (key) {
    case 's':
        request->store_dir = arg;
        return 0;
    case 't':
        request->threads = take_whole(arg, "threads", MOST_THREADS, state);
        return 0;
    case 'j':
        request->json = 1;
        return 0;
    case OPT_MINUTES:
        request->minutes = take_whole(arg, "minutes", MOST_MINUTES, state);
        return 0;
    case OPT_QUICK:
        request->quick = 1;
        return 0;
    case OPT_JOURNAL:
        request->journal = arg;
        return 0;
    case OPT_REPLACE:
        request->replace = 1;
        return 0;
    case OPT_SERVED:
        request->served = 1;
        return 0;
    case OPT_VOLUME:
        request->volume = arg;
        return 0;
    case OPT_TILE:
        request->tile = arg;
        return 0;
    case OPT_REFERENCE:
        request->reference = arg;
        return 0;
    case OPT_SPECIMEN:
        request->specimen = arg;
        return 0;
    case OPT_SPACING_UNIT:
        if (strcmp(arg, "mm") != 0 && strcmp(arg, "um") != 0)
            argp_error(state, "--spacing-unit must be mm or um, not \"%s\"", arg);
        request->spacing_unit = arg;
        return 0;
    case OPT_MARKS:
        request->marks = arg;
        return 0;
    case OPT_PX_UM:
        request->px_um = arg;
        return 0;
    case OPT_BY_TISSUE:
        request->by_tissue = 1;
        return 0;
    case OPT_RADIUS:
        request->radius = arg;
        return 0;
    case OPT_CSV:
        request->csv = 1;
        return 0;
    case OPT_QUIET:
        request->quiet = 1;
        return 0;
    case OPT_BECAUSE:
        request->because = arg;
        return 0;
    case OPT_DIFFERENCE:
        request->difference = arg;
        return 0;
    case OPT_SD:
        request->sd = arg;
        return 0;
    case OPT_POWER:
        request->power = arg;
        return 0;
    case OPT_THRESHOLD:
        take_number(arg, "threshold", &request->thresholds, state);
        return 0;
    case OPT_LEVEL:
        take_number(arg, "level", &request->levels, state);
        return 0;
    case OPT_STEP:
        request->step = arg;
        return 0;
    case OPT_WHOLE:
        request->whole = 1;
        return 0;
    case OPT_BOX:
        request->box = arg;
        return 0;
    case OPT_PLANE:
        request->plane = arg;
        return 0;
    case OPT_TRANSLUCENT:
        request->translucent = 1;
        return 0;
    case OPT_TRUE_COLOUR:
        request->true_colour = 1;
        return 0;
    case OPT_PREVIEW:
        request->preview = 1;
        return 0;
    case OPT_SURFACE:
        request->surface = arg;
        return 0;
    case OPT_CELLS:
        request->cells = arg;
        return 0;
    case OPT_VIEW:
        request->view = arg;
        return 0;
    case OPT_SIZE:
        request->size = arg;
        return 0;
    case OPT_WINDOW:
        request->window = arg;
        return 0;
    case OPT_PERSPECTIVE:
        request->perspective = 1;
        return 0;
    case OPT_POINTS:
        request->points = arg;
        return 0;
    case OPT_PUBLISH:
        request->publish = arg;
        return 0;
    case ARGP_KEY_ARG:
        if (request->verb)
            request->rest[request->rest_count++] = arg;
        else
            request->verb = arg;
        return 0;
    case ARGP_KEY_END:
        if (!request->verb)
            argp_error(state, "say what to do: import, work, changed, verify, scrub, backup, "
                              "restore, check, register, study, plan, export, render, probe, line, "
                              "integral or index");
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

int main(int argc, char **argv)
{
    static const struct {
        const char *verb;
        int needs_store;
        int (*run)(const struct gsn_work_request *request);
    } verbs[] = { { "import", 1, gsn_work_import },     { "work", 1, gsn_work_next },
                  { "changed", 1, gsn_work_changed },   { "verify", 1, gsn_work_verify },
                  { "scrub", 1, gsn_work_scrub },       { "backup", 1, gsn_work_backup },
                  { "restore", 1, gsn_work_restore },   { "check", 0, gsn_work_check },
                  { "register", 0, gsn_work_register }, { "study", 1, gsn_work_study },
                  { "plan", 0, gsn_work_plan },         { "export", 1, gsn_work_export },
                  { "probe", 1, gsn_work_probe },       { "line", 1, gsn_work_line },
                  { "integral", 1, gsn_work_integral }, { "index", 1, gsn_work_index },
                  { "render", 1, gsn_work_render } };
    static const struct argp parser = { .options = options,
                                        .parser = take_option,
                                        .args_doc = "VERB [ARGUMENT...]",
                                        .doc = "Does one piece of gieson's work and ends." };
    gsn_auto_mem(char *) rest = gsn_alloc_array((size_t)argc, sizeof *rest);
    struct gsn_work_request request = { .store_dir = getenv("GIESON_STORE"), .rest = rest };
    int status = EX_USAGE;
    size_t i = 0;

    if (!rest)
        return EX_OSERR;
    if (argp_parse(&parser, argc, argv, ARGP_IN_ORDER, NULL, &request) != 0)
        return EX_USAGE;
    while (i < sizeof verbs / sizeof verbs[0] && strcmp(verbs[i].verb, request.verb) != 0)
        i++;
    if (i == sizeof verbs / sizeof verbs[0])
        status = gsn_work_usage(
            &request, "this verb is not known: import, work, changed, verify, scrub, "
                      "backup, restore, check, register, study, plan, export, render, probe, "
                      "line, integral or index");
    else if (verbs[i].needs_store && (!request.store_dir || !request.store_dir[0]))
        status = gsn_work_usage(&request, "no store: say --store DIR or set GIESON_STORE");
    else
        status = verbs[i].run(&request);
    json_decref(request.thresholds);
    json_decref(request.levels);
    return status;
}
