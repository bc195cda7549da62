/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson: the technician's and the biologist's command. It reads the store and asks for work; the
 * work itself is done by gieson-work, which it starts. */
#include <argp.h>
#include <errno.h>
#include <limits.h>
#include <locale.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sysexits.h>
#include <unistd.h>

#include "storage/advice.h"
#include "ui/help.h"
#include "ui/ui.h"

const char *argp_program_version = "gieson " GSN_VERSION;

static const struct {
    const char *name;
    gsn_verb *run;
} verbs[] = {
    { "status", gsn_cmd_status },     { "top", gsn_cmd_top },
    { "show", gsn_cmd_show },         { "import", gsn_cmd_import },
    { "new", gsn_cmd_new },           { "file", gsn_cmd_file },
    { "expect", gsn_cmd_expect },     { "capture", gsn_cmd_capture },
    { "run", gsn_cmd_run },           { "night", gsn_cmd_night },
    { "retry", gsn_cmd_retry },       { "decide", gsn_cmd_decide },
    { "report", gsn_cmd_report },     { "study", gsn_cmd_study },
    { "plan", gsn_cmd_plan },         { "index", gsn_cmd_index },
    { "export", gsn_cmd_model },      { "probe", gsn_cmd_model },
    { "render", gsn_cmd_model },
    { "line", gsn_cmd_model },        { "integral", gsn_cmd_model },
    { "verify", gsn_cmd_verify },     { "scrub", gsn_cmd_scrub },
    { "backup", gsn_cmd_backup },     { "restore", gsn_cmd_restore },
    { "check", gsn_cmd_check },       { "check-config", gsn_cmd_check_config },
    { "register", gsn_cmd_register }, { "devices", gsn_cmd_devices },
    { "demo", gsn_cmd_demo },         { "phantom", gsn_cmd_phantom },
    { "trace", gsn_cmd_trace },
};

static const char doc[] =
    "From stained sections on scanned panels to the collagen that was lost.\v"
    /* Lines of at most 76 columns: argp breaks longer ones where it likes. */
    "`gieson VERB --help` tells more of each, with an example.\n\n"
    "Verbs:\n"
    "  new FOLDER          a folder with a job.json to be filled in\n"
    "  import FOLDER       take panels beside a job.json into the store\n"
    "                      (--volume FILE, --tile FILE: a volume or one picture)\n"
    "  run                 do all jobs that wait\n"
    "  night               compute every specimen that changed since its report\n"
    "  status              what is in the store, and what to do next\n"
    "  top                 the same on a screen that follows; ? lists its keys\n"
    "  show SPECIMEN       its panels, sections and figures\n"
    "  report SPECIMEN     where its report is; with --json the report itself\n"
    "  trace SPECIMEN      what its figure rests on: runs, sections, files, hashes,\n"
    "                      and what changed since the run before (or of a study)\n"
    "  study [NAME]        the groups of a study, their losses and intervals over\n"
    "                      animals: a page, a table, JSON\n"
    "  plan                how many animals a difference needs\n"
    "  index               the front page of the store: every specimen and study\n"
    "  export SPECIMEN FILE\n"
    "                      its model for other programs: .vtkhdf .vtu .csv .stl\n"
    "                      .ply .glb .nrrd .nii.gz .ome.tif\n"
    "  render SPECIMEN... FILE.png\n"
    "                      a picture of its model: X-ray, translucent, surface\n"
    "  probe SPECIMEN X Y Z\n"
    "                      the model at a point, and the pixels it rests on\n"
    "  line SPECIMEN X1 Y1 Z1 X2 Y2 Z2\n"
    "                      the model along a segment, and its integral\n"
    "  integral SPECIMEN   over the region, a box, a plane; volumes above a\n"
    "                      level with guaranteed bounds of the model\n"
    "  retry [SPECIMEN]    let failed jobs wait again\n"
    "  decide SPECIMEN PLACE ANSWER\n"
    "                      answer what `show` asks: cut, hold, slot N, dismiss,\n"
    "                      use FILE, first N, as-set, as-marked, lost;\n"
    "                      undo takes it back\n"
    "  verify RUN          compute a finished run again from its bytes and\n"
    "                      compare every byte, figure and file\n"
    "  scrub               look the store over: database, audit log, reports, and\n"
    "                      every original's hash (--quick: without these)\n"
    "  backup FOLDER       copy the store and read the copy back\n"
    "  restore FOLDER      make the store from such a copy\n"
    "  check FILE...       decode pictures strictly and say what they are\n"
    "  register FOLDER     how the sections of a plain folder of pictures lie\n"
    "  demo [FOLDER]       two phantom specimens from panels to reports\n"
    "  phantom ...         make a specimen with a known truth (phantom --help)\n"
    "The bench:\n"
    "  file SCAN SPECIMEN --panel N | file SCAN undo\n"
    "                      say where a scan belongs that nobody could place\n"
    "  expect SOURCE SPECIMEN\n"
    "                      what this source delivers is this specimen's, until\n"
    "                      `expect SOURCE --nobody`\n"
    "  capture SOURCE      take a picture now (--blank: of clean glass,\n"
    "                      --dark: with the lens covered)\n"
    "  devices             what is plugged in, with the addresses to configure\n"
    "  check-config [FILE] what is wrong with the service's configuration\n";

static const struct argp_option options[] = {
    { "store", 's', "DIR", 0, "The store (default: $GIESON_STORE, else the service's)", 0 },
    { "json", 'j', NULL, 0, "Print JSON", 0 },
    { 0 },
};

/* The verb and everything behind it. */
struct rest {
    struct gsn_ui *ui;
    int argc;
    char **argv;
};

static error_t take_option(int key, char *arg, struct argp_state *state)
{
    struct rest *rest = state->input;

    switch (key) {
    case 's':
        rest->ui->store_dir = arg;
        return 0;
    case 'j':
        rest->ui->json = 1;
        return 0;
    case ARGP_KEY_ARG:
        return ARGP_ERR_UNKNOWN;
    case ARGP_KEY_ARGS:
        rest->argv = state->argv + state->next;
        rest->argc = state->argc - state->next;
        return 0;
    default:
        return ARGP_ERR_UNKNOWN;
    }
}

/* Our options may also stand behind the verb; they are taken out of its arguments. What is behind
 * --because is a person's, and phantom's are its own program's. ret_help: whether help is asked
 * for. */
static int take_late_options(struct rest *rest, int *ret_help)
{
    const int is_phantom = rest->argc > 0 && strcmp(rest->argv[0], "phantom") == 0;
    int kept = 0;

    *ret_help = 0;
    for (int i = 0; i < rest->argc; i++) {
        const char *word = rest->argv[i];

        if (is_phantom)
            rest->argv[kept++] = rest->argv[i];
        else if (strcmp(word, "--json") == 0 || strcmp(word, "-j") == 0)
            rest->ui->json = 1;
        else if ((strcmp(word, "--store") == 0 || strcmp(word, "-s") == 0) && i + 1 < rest->argc)
            rest->ui->store_dir = rest->argv[++i];
        else if (strncmp(word, "--store=", 8) == 0)
            rest->ui->store_dir = word + 8;
        else if (strcmp(word, "--help") == 0 || strcmp(word, "-?") == 0)
            *ret_help = 1;
        else {
            rest->argv[kept++] = rest->argv[i];
            if (strcmp(word, "--because") == 0 && i + 1 < rest->argc)
                rest->argv[kept++] = rest->argv[++i];
        }
    }
    return kept;
}

static int is_store(const char *dir)
{
    gsn_auto_mem(char) database = gsn_format("%s/gieson.db", dir);

    return database && access(database, F_OK) == 0;
}

static void look_around(struct gsn_ui *ui)
{
    const char *no_colour = getenv("NO_COLOR");

    ui->store_dir = getenv("GIESON_STORE");
    /* Where the package's services keep theirs; only when there is one. */
    if ((!ui->store_dir || !ui->store_dir[0]) && is_store(gsn_advice_usual_store()))
        ui->store_dir = gsn_advice_usual_store();
    ui->out_tty = isatty(STDOUT_FILENO);
    ui->err_tty = isatty(STDERR_FILENO);
    ui->colour = ui->out_tty && !(no_colour && no_colour[0]);
    ui->width = ui->out_tty ? gsn_ui_columns(STDOUT_FILENO) : INT_MAX;
}

static int unknown_verb(const struct gsn_ui *ui, const char *verb)
{
    const char *near = gsn_help_nearest(verb);

    return gsn_ui_usage(ui, "\"%s\" is not a verb%s%s%s; `gieson --help` lists them", verb,
                        near ? ": did you mean \"" : "", near ? near : "", near ? "\"?" : "");
}

static int run_verb(struct gsn_ui *ui, struct rest *rest)
{
    int help;

    if (rest->argc == 0)
        return gsn_ui_usage(ui,
                            "say what to do, for instance `gieson status`; `gieson --help` lists "
                            "the verbs");
    rest->argc = take_late_options(rest, &help);
    for (size_t i = 0; rest->argc > 0 && i < sizeof verbs / sizeof verbs[0]; i++) {
        if (strcmp(verbs[i].name, rest->argv[0]) != 0)
            continue;
        if (!help)
            return verbs[i].run(ui, rest->argc, rest->argv);
        gsn_help_print(gsn_help_of(rest->argv[0]));
        return EX_OK;
    }
    return unknown_verb(ui, rest->argc > 0 ? rest->argv[0] : "");
}

/* An answer that did not reach its reader is no success. */
static int close_answer(int status)
{
    const int failed = ferror(stdout);

    if (fflush(stdout) == 0 && !failed)
        return status;
    (void)fprintf(stderr, "gieson: the answer could not be written: %s\n", strerror(errno));
    return status == EX_OK ? EX_IOERR : status;
}

int main(int argc, char **argv)
{
    static const struct argp parser = {
        .options = options, .parser = take_option, .args_doc = "VERB [ARGUMENT...]", .doc = doc
    };
    struct gsn_ui ui = { 0 };
    struct rest rest = { .ui = &ui };

    (void)setlocale(LC_CTYPE, "C.UTF-8");
    look_around(&ui);
    if (argp_parse(&parser, argc, argv, ARGP_IN_ORDER, NULL, &rest) != 0)
        return EX_USAGE;
    return close_answer(run_verb(&ui, &rest));
}
