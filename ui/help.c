/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pages of `gieson help`: one a verb, with an example that can be typed; and the nearest verb
 * to a mistyped one, by the fewest slips of the hand (pipeline/core/nearest.h). */
#include "ui/help.h"

#include <stdio.h>
#include <string.h>

#include "pipeline/core/nearest.h"

static const struct gsn_help pages[] = {
    { "status", "", "What is in the store, a line a specimen, each with the command to give next.",
      "", "gieson status\ngieson status -j | jq '.specimens[].state'" },
    { "top", "", "The same on a screen that follows; ? lists its keys, q ends it.", "",
      "gieson top" },
    { "show", "SPECIMEN", "Its panels, the sections that need an eye, its runs and figures.", "",
      "gieson show R07-left" },
    { "import", "FOLDER | --volume FILE | --tile FILE",
      "Takes the panels beside a job.json into the store, with the files that it names; or one "
      "volume,\n"
      "or one picture of stained tissue. Nothing at the source is changed. What can be told of the "
      "job\n"
      "is told before any work: keys, units, panels that are missing, what will be withheld.",
      "  --replace            a specimen of the same name takes the new job.json\n"
      "  --specimen NAME      of a volume or tile (default: the file's name)\n"
      "  --threshold X        volume above this density; up to 8 times\n"
      "  --spacing-unit UNIT  of a volume whose header does not say: mm or um\n"
      "  --reference FILE     a mask beside a tile to compare its map with\n",
      "gieson new R07-left && $EDITOR R07-left/job.json\ngieson import R07-left\n"
      "gieson import --volume tooth.mhd --spacing-unit mm --threshold 100" },
    { "new", "FOLDER",
      "Writes FOLDER/job.json, a template with a comment beside each key, and nothing else. One "
      "that is\n"
      "there already is left as it is.",
      "", "gieson new R07-left" },
    { "run", "",
      "Does all jobs that wait. Ends with 65 when a job failed, or when every specimen in the\n"
      "store is withheld.",
      "  --threads N          0 (all) to 64; the bytes of a report do not depend on it\n",
      "gieson run --threads 2" },
    { "night", "",
      "Computes every specimen that changed since its last report, prints a line for each, and "
      "makes "
      "the\n"
      "pages of all studies again.",
      "  --threads N          0 (all) to 64\n"
      "  --slurm              submit it to Slurm, on the machine that has the store\n",
      "gieson night" },
    { "retry", "[SPECIMEN]", "Lets failed jobs, of one specimen or of all, wait again.", "",
      "gieson retry R07-left && gieson run" },
    { "decide", "SPECIMEN PLACE ANSWER",
      "Answers what `gieson show` asks. The place is a panel's number (3), or a slot of it (3.6), "
      "slots\n"
      "counted from 1 in the order of mounting.\n"
      "Of a slot:  cut, hold, slot N, dismiss, pose N\n"
      "Of a panel: use FILE, first N, as-marked, as-set, lost\n"
      "undo takes an answer back.",
      "  --because TEXT       why; kept with the answer\n",
      "gieson decide R07-left 2.6 pose 2 --because 'the crack is on the left'" },
    { "report", "SPECIMEN",
      "Where its latest report is: the page, its JSON, its PDF; with --json the report itself.", "",
      "gieson report R07-left\ngieson report R07-left --json | jq .loss_percent" },
    { "trace", "SPECIMEN | STUDY",
      "What a figure rests on: how it is computed, the baseline's runs, the sections that were "
      "not\n"
      "used and why, every file with its hash, what people decided; and each parameter, file and\n"
      "figure in which it differs from the run before. Of a study: its animals and their runs.",
      "", "gieson trace R07-left" },
    { "study", "[NAME [STATEMENT]]",
      "Makes the page of a study (of all without a name) from the latest reports: groups, losses "
      "with\n"
      "their intervals over animals, one dot an animal, what limits the answer. Prints the "
      "figures.\n"
      "Statements, which the audit log keeps:\n"
      "exclude SPECIMEN --because WHY, include SPECIMEN: who takes part, set beforehand\n"
      "blind: hides the names of groups; freeze: ends changes; unblind: shows them after that",
      "  --csv                a row an animal and measure, for R, pandas, Prism\n"
      "  --because TEXT       why a specimen is excluded\n",
      "gieson study periodontitis\n"
      "gieson study periodontitis exclude R07-left --because 'the block broke'" },
    { "plan", "--difference POINTS --sd POINTS | STUDY --difference POINTS",
      "How many animals a group needs to find a difference of losses, in points, by a two-sided t\n"
      "test at 5 %. What animals differ by is stated, or taken from a study.",
      "  --difference POINTS  to be found\n"
      "  --sd POINTS          what losses of animals differ by\n"
      "  --power P            how surely (default: 0.8)\n",
      "gieson plan --difference 10 --sd 6" },
    { "index", "",
      "Makes the front page of the store, index.html in it: every specimen with its loss, what "
      "needs a\n"
      "person, the pages of the studies; and reports/SPECIMEN/latest. `gieson run` and `gieson "
      "night`\n"
      "make it again. Pages are files: a copy of them on a share or a web server needs no gieson.",
      "  --publish FOLDER     copy index.html, studies and reports there\n",
      "gieson index --publish /srv/www/gieson" },
    { "export", "SPECIMEN FILE",
      "Writes the model of its last run as a file of another program; the ending says which:\n"
      ".vtkhdf .vtu       the model itself, Bezier tetrahedra, for ParaView and VTK\n"
      ".csv               its tetrahedra (micro-units), a row each\n"
      ".stl .ply .glb     the surface at one density, closed where the region ends\n"
      ".nrrd .nii.gz      the density on a grid (default: the stack's own voxels)\n"
      ".ome.tif           the aligned sections in true colour; says how job.json names a region\n"
      "                   drawn on them\n"
      "Surfaces and volumes end where the region ends. A file that exists is not written over.",
      "  --level V            of a surface\n"
      "  --step UM            size of a volume's voxels; of the cells a surface is made in, at "
      "most\n                       (default: triangles within a tenth of a voxel)\n"
      "  --whole              beyond the region too, as far as the model goes\n",
      "gieson export R07-left R07-left.stl --level 0.5\n"
      "gieson export R07-left R07-left.nrrd --step 12" },
    { "render", "SPECIMEN... FILE.png",
      "A picture of the model of its last run, by rays through the spline itself: the X-ray of "
      "the\n"
      "region, unless an option says another. It ends where the region ends. Up to eight "
      "specimens\n"
      "stand side by side, on one scale. A file that exists is not written over.",
      "  --translucent        emission and absorption, in the colours of the density\n"
      "  --surface V[,V...]   where the density is V; cuts show the density. Of several the\n"
      "                       greatest, seen through the others\n"
      "  --true-colour        these two in the colours of the sections\n"
      "  --cells PERCENT      the model's cells apart, of that size, in the colours of their "
      "means\n"
      "  --window LOW,HIGH    densities of the colour scale, transparent to full\n"
      "                       (default: 0 to the greatest mean of a cell)\n"
      "  --view X,Y,Z         direction of the eye into the block; or x, y, z, corner (default)\n"
      "  --perspective        seen by an eye, not by parallel rays\n"
      "  --preview            quickly: X-ray or light of cells, linear in each\n"
      "  --box X1,Y1,Z1,X2,Y2,Z2\n"
      "                       show what is in the box, micrometres\n"
      "  --plane X,Y,Z,NX,NY,NZ\n"
      "                       cut away what lies on the normal's side of the point\n"
      "  --size PX            width and height (default: 640)\n"
      "  --whole              beyond the region too, as far as the model goes\n",
      "gieson render R07-left xray.png\n"
      "gieson render R07-left cut.png --surface 0.5 --plane 0,0,300,0,0,-1\n"
      "gieson render R07-left shells.png --surface 0.3,0.5,0.8\n"
      "gieson render week0 week4 week8 weeks.png --surface 0.5" },
    { "probe", "SPECIMEN X Y Z",
      "The model at a point of the block, in micrometres: value, gradient, the cell around it "
      "with\n"
      "what it rests on and bounds of the model in it, and the pixels of the nearest two "
      "sections.\n"
      "With --json second derivatives too. A point without data is refused.",
      "", "gieson probe R07-left -300 120 450" },
    { "line", "SPECIMEN X1 Y1 Z1 X2 Y2 Z2",
      "The exact integral of the model along a segment, in the region and in the whole domain, and "
      "a\n"
      "profile.",
      "  --points N           of the profile (default: 33)\n",
      "gieson line R07-left -300 120 0 -300 120 600 --points 101" },
    { "integral", "SPECIMEN",
      "Volume, integral and mean of the model over the region, or over a part of it. A box takes "
      "the\n"
      "voxels whose centre it holds, so that boxes side by side add up.",
      "  --level V            volume above V, with bounds of the model that are guaranteed;\n"
      "                       up to 8 times\n"
      "  --box X1,Y1,Z1,X2,Y2,Z2\n"
      "                       two corners, micrometres\n"
      "  --plane X,Y,Z,NX,NY,NZ\n"
      "                       a point and a normal: area, integral and mean on the plane\n"
      "  --whole              the whole domain, cell by cell\n",
      "gieson integral R07-left --level 0.3 --level 0.5\n"
      "gieson integral R07-left --plane 0,0,300,0,0,1 --json" },
    { "verify", "RUN | SPECIMEN",
      "Computes a finished run again and compares every byte; ends with 1 when one\n"
      "differs.",
      "", "gieson verify R07-left" },
    { "scrub", "", "Reads every stored original again and compares its hash.",
      "  --minutes N          stop after so long; the next one goes on there\n"
      "  --quick              database, log and reports alone\n"
      "  --journal FILE       compare the audit log with what the journal has of it\n",
      "gieson scrub --minutes 30" },
    { "backup", "FOLDER", "Copies the store, whole and verified, into a new or an empty folder.",
      "", "gieson backup /media/disk/gieson" },
    { "restore", "FOLDER", "Makes a new store of a backup, verified.", "",
      "gieson restore /media/disk/gieson --store new-store" },
    { "check", "FILE...",
      "Decodes pictures strictly and says what each is, or why it is refused. Needs no\n"
      "store.",
      "", "gieson check R07-left/R07-P03.tif" },
    { "register", "FOLDER", "How the sections of a plain folder of pictures lie. Needs no store.",
      "  --marks X,Y X,Y X,Y  where the marks are in the frame wanted\n"
      "  --px-um UM           size of a pixel; without it lengths are pixels\n"
      "  --radius R           the error is given over this disc\n"
      "  --by-tissue          lay sections without marks by their neighbours' tissue\n",
      "gieson register sections --px-um 10.58 --json > poses.json" },
    { "demo", "[FOLDER]",
      "Two phantom specimens with a known truth from panels to reports, in FOLDER (default:\n"
      "demo).",
      "", "gieson demo" },
    { "phantom", "...", "Makes a specimen with a known truth.", "", "gieson phantom --help" },
    { "file", "SCAN SPECIMEN --panel N",
      "Says where a scan belongs that nobody could place, or which number a\n"
      "held panel has.",
      "  --panel N            its number in the specimen\n", "gieson file 18 R07-left --panel 3" },
    { "expect", "SOURCE SPECIMEN | SOURCE --nobody",
      "From now on what the source delivers belongs to the specimen, or to nobody.",
      "  --nobody             end that\n", "gieson expect scanner R07-left" },
    { "capture", "SOURCE", "Has the service take a picture now, and waits for it.",
      "  --blank              of clean glass\n  --dark               with the lens covered\n",
      "gieson capture copystand --blank" },
    { "devices", "",
      "What is plugged in and could be a source, with its address for the configuration.", "",
      "gieson devices" },
    { "check-config", "[FILE]",
      "What is wrong with the configuration of the service, or with another file, with\n"
      "file, line and reason; 66 when there is none, 78 when it is wrong.",
      "", "gieson check-config /etc/gieson/gieson.conf" },
};

enum { PAGES = sizeof pages / sizeof pages[0] };

const struct gsn_help *gsn_help_of(const char *verb)
{
    for (size_t i = 0; i < PAGES; i++)
        if (strcmp(pages[i].verb, verb) == 0)
            return &pages[i];
    return NULL;
}

const char *gsn_help_nearest(const char *verb)
{
    const char *names[PAGES];

    for (size_t i = 0; i < PAGES; i++)
        names[i] = pages[i].verb;
    return gsn_nearest(verb, names, PAGES);
}

void gsn_help_print(const struct gsn_help *help)
{
    const char *line = help->example;

    (void)printf("usage: gieson %s%s%s\n\n%s\n", help->verb, help->arguments[0] ? " " : "",
                 help->arguments, help->what);
    (void)printf("\nOptions:\n%s"
                 "  -s, --store DIR      the store\n"
                 "  -j, --json           print JSON\n"
                 "\nExample:\n",
                 help->options);
    while (*line) {
        const size_t length = strcspn(line, "\n");

        (void)printf("  %.*s\n", (int)length, line);
        line += length + (line[length] == '\n');
    }
}
