/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/lettering.h"

#include <dlfcn.h>
#include <fontconfig/fontconfig.h>
#include <pango/pangofc-fontmap.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>

#include "pipeline/core/parallel.h"
#include "tests/check.h"

static const struct gsn_colour white = { 255, 255, 255 }, black = { 0, 0, 0 };

static struct gsn_lettering *open_letters(void)
{
    struct gsn_lettering *letters = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_lettering_new(GSN_FONT_FOLDER, &letters, &err), err);
    return letters;
}

enum { WIDE = 900, HIGH = 120, LEFT = 30, TOP = 30 };

static struct gsn_image *write_out(struct gsn_lettering *letters, enum gsn_face face, double px,
                                   const char *text)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_canvas_new(WIDE, HIGH, white, &image, &err), err);
    CHECK_OK(gsn_lettering_draw(letters, image, LEFT, TOP, face, px, text, black, &err), err);
    return image;
}

/* Whether two texts have the same pixels. */
static int look_alike(struct gsn_lettering *letters, const char *a, const char *b)
{
    gsn_auto(gsn_image) one = write_out(letters, GSN_FACE_PLAIN, 12.0, a);
    gsn_auto(gsn_image) other = write_out(letters, GSN_FACE_PLAIN, 12.0, b);

    return memcmp(one->samples, other->samples, gsn_image_bytes(one)) == 0;
}

TEST(ink_lies_in_the_box_that_was_measured)
{
    static const char *const said[4] = { "data", "z = 1250 \xc2\xb5m  (x right, y down)", "Qgjpqy|",
                                         "\xc3\x84\xc3\x89 mm\xc2\xb3" };
    gsn_auto(gsn_lettering) letters = open_letters();

    for (int i = 0; i < 4 * 3 * 2; i++) {
        const enum gsn_face face = i / 12 ? GSN_FACE_BOLD : GSN_FACE_PLAIN;
        const double px = 9.0 + 8.0 * (i / 4 % 3);
        gsn_auto(gsn_image) image = write_out(letters, face, px, said[i % 4]);
        const int width = gsn_lettering_width(letters, face, px, said[i % 4]);
        const int height = gsn_lettering_height(letters, face, px);
        int last = 0;

        for (int y = 0; y < HIGH; y++) {
            for (int x = 0; x < WIDE; x++) {
                if (gsn_image_at(image, (uint32_t)x, (uint32_t)y, 0) == 255)
                    continue;
                /* Hinting may move an edge by a pixel. */
                CHECK(x >= LEFT - 1 && x <= LEFT + width && y >= TOP - 1 && y <= TOP + height);
                last = x > last ? x : last;
            }
        }
        /* And fills it: no letter is wider than a third of the whole. */
        CHECK(last > LEFT + width - (int)px / 2);
    }
}

TEST(letters_are_as_wide_as_the_font_says)
{
    gsn_auto(gsn_lettering) letters = open_letters();

    /* Advances of DejaVu Sans, of 2048 units an em; each is rounded to a pixel. */
    CHECK(gsn_lettering_width(letters, GSN_FACE_PLAIN, 64.0, "0000000000") == 410); /* 1303 */
    CHECK(gsn_lettering_width(letters, GSN_FACE_PLAIN, 64.0, "mmmm") == 248);       /* 1995 */
    CHECK(gsn_lettering_width(letters, GSN_FACE_BOLD, 64.0, "0000000000") == 450);  /* 1425 */
    CHECK(gsn_lettering_width(letters, GSN_FACE_PLAIN, 12.0, "") == 0);
}

TEST(every_printable_character_has_a_face_of_its_own)
{
    gsn_auto(gsn_lettering) letters = open_letters();
    struct gsn_image *cell[95];

    for (int c = 0; c < 95; c++) {
        const char text[2] = { (char)(c + 32), '\0' };

        cell[c] = write_out(letters, GSN_FACE_PLAIN, 12.0, text);
        for (int other = 0; other < c; other++)
            CHECK(memcmp(cell[c]->samples, cell[other]->samples, gsn_image_bytes(cell[c])) != 0);
    }
    for (int c = 0; c < 95; c++)
        gsn_image_free(cell[c]);
}

TEST(characters_beyond_ascii_are_not_dropped)
{
    static const char *const said[9] = { "",         "\xc2\xb5", "\xc2\xb2", "\xc2\xb3", "\xc2\xb0",
                                         "\xc3\x97", "\xc3\xa4", "\xce\xbb", "\xd0\x96" };
    gsn_auto(gsn_lettering) letters = open_letters();

    for (int i = 0; i < 9; i++) {
        for (int j = 0; j < i; j++)
            CHECK(!look_alike(letters, said[i], said[j]));
    }
}

TEST(a_character_that_the_font_lacks_is_named)
{
    gsn_auto(gsn_lettering) letters = open_letters();

    CHECK(look_alike(letters, "a\xe4\xb8\xad", "a[U+4E2D]"));
    CHECK(look_alike(letters, "\xf0\x9f\x94\xac", "[U+1F52C]"));
    /* What would turn the line around or break it does neither. */
    CHECK(look_alike(letters,
                     "a\xe2\x80\xae"
                     "bc",
                     "a[U+202E]bc"));
    CHECK(look_alike(letters, "a\nb", "a[U+000A]b"));
    /* Cut off in the middle of a character. */
    CHECK(look_alike(letters, "a\xc2", "a\xef\xbf\xbd"));
}

TEST(without_the_font_the_package_is_named_and_nothing_is_given)
{
    char folder[] = "/tmp/gsn_lettering_XXXXXX", path[64];
    struct gsn_lettering *letters = NULL;
    struct gsn_error err = { 0 };
    FILE *file;

    CHECK(gsn_lettering_new("/nowhere", &letters, &err) == GSN_E_NOTFOUND);
    CHECK(strstr(err.text, "/nowhere/DejaVuSans.ttf") && strstr(err.text, "fonts-dejavu-core"));
    CHECK(letters == NULL);
    CHECK(mkdtemp(folder) != NULL);
    (void)snprintf(path, sizeof path, "%s/DejaVuSans.ttf", folder);
    file = fopen(path, "w");
    CHECK(file && fputs("no font", file) >= 0 && fclose(file) == 0);
    CHECK(gsn_lettering_new(folder, &letters, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "is damaged") && strstr(err.text, "fonts-dejavu-core again"));
    CHECK(letters == NULL);
    CHECK(unlink(path) == 0 && rmdir(folder) == 0);
}

static struct gsn_image *mount(const struct gsn_plate *plate, uint32_t width, uint32_t height,
                               int *ret_x, int *ret_y)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plate_new(plate, width, height, &image, ret_x, ret_y, &err), err);
    return image;
}

static int is_white(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    return gsn_image_at(image, x, y, 0) == 255 && gsn_image_at(image, x, y, 1) == 255 &&
           gsn_image_at(image, x, y, 2) == 255;
}

/* The ink of sheets. */
static int is_ink(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    return gsn_image_at(image, x, y, 0) == 40 && gsn_image_at(image, x, y, 2) == 46;
}

TEST(a_scale_bar_has_a_round_length)
{
    const struct {
        double um_per_px;
        uint32_t width; /* the bar takes a quarter of it at most */
        uint32_t px;
    } case_of[4] = { { 10.0, 400, 100 }, { 7.0, 400, 71 }, { 16.0, 240, 31 }, { 0.3, 360, 67 } };

    for (int i = 0; i < 4; i++) {
        const struct gsn_plate plate = { .um_per_px = case_of[i].um_per_px };
        uint32_t longest = 0;
        int x0, y0;
        gsn_auto(gsn_image) image = mount(&plate, case_of[i].width, 50, &x0, &y0);

        for (uint32_t y = (uint32_t)y0 + 51; y < image->height; y++) {
            uint32_t run = 0;

            for (uint32_t x = 0; x < image->width; x++) {
                run = is_ink(image, x, y) ? run + 1 : 0;
                longest = run > longest ? run : longest;
            }
        }
        CHECK(longest == case_of[i].px);
    }
}

TEST(a_colour_scale_runs_from_low_below_to_high_above)
{
    const struct gsn_plate plate = {
        .has_scale = 1, .low = 0.0, .high = 1.0, .map = GSN_MAP_GREY, .unit = "density"
    };
    unsigned before = 256, rows = 0;
    int x0, y0;
    gsn_auto(gsn_image) image = mount(&plate, 100, 140, &x0, &y0);
    const uint32_t column = (uint32_t)x0 + 100 + 12 + 7;
    uint32_t y = (uint32_t)y0 + 16;

    while (!is_ink(image, column, y))
        y++; /* the frame above */
    for (y++; !is_ink(image, column, y); y++, rows++) {
        CHECK(gsn_image_at(image, column, y, 0) <= before);
        before = gsn_image_at(image, column, y, 0);
        CHECK(rows > 0 || before > 250);
    }
    CHECK(before < 5 && rows > 80);
}

TEST(numbers_beside_a_colour_scale_stand_apart)
{
    for (uint32_t height = 1; height < 300; height += 23) {
        const struct gsn_plate plate = { .has_scale = 1, .low = -0.07, .high = 0.31 };
        int x0, y0, runs = 0, inked = 0;
        gsn_auto(gsn_image) image = mount(&plate, 60, height, &x0, &y0);

        /* Right of the scale and its ticks there are numbers alone. */
        for (uint32_t y = 0; y < image->height; y++) {
            int here = 0;

            for (uint32_t x = (uint32_t)x0 + 60 + 12 + 14 + 5; x < image->width; x++)
                here |= !is_white(image, x, y);
            runs += here && !inked;
            inked = here;
        }
        /* At least two say what the colours mean. */
        CHECK(runs >= 2 && runs <= 9);
    }
}

TEST(nothing_on_a_sheet_is_cut_off_at_its_edge)
{
    static const char *const said[4] = { NULL, "x",
                                         "density \xc3\x97 \xc2\xb5m, of the whole region",
                                         "a title that is far wider than the picture under it g" };

    for (int i = 0; i < 4 * 4 * 4 * 2; i++) {
        const struct gsn_plate plate = { .title = said[i % 4],
                                         .note = said[i / 4 % 4],
                                         .unit = said[i / 16 % 4],
                                         .um_per_px = i / 64 ? 7.3 : 0.0,
                                         .has_scale = 1,
                                         .low = -123456.0,
                                         .high = 123456.0 };
        const uint32_t side = i % 3 ? 240 : 1;
        int x0, y0;
        gsn_auto(gsn_image) image = mount(&plate, side, side, &x0, &y0);

        for (uint32_t y = 0; y < image->height; y++) {
            for (uint32_t x = 0; x < image->width; x++) {
                if (x < 8 || y < 8 || x + 8 >= image->width || y + 8 >= image->height)
                    CHECK(is_white(image, x, y));
            }
        }
    }
}

static int draw_one(size_t index, void *context, struct gsn_error *err)
{
    const struct gsn_plate plate = { .title = index % 2 ? "X-ray" : "data, z = 3",
                                     .note = "integral along the line of view",
                                     .um_per_px = 3.0 + (double)index };
    struct gsn_image **image = context;
    int x, y;

    return gsn_plate_new(&plate, 90, 60, &image[index], &x, &y, err);
}

TEST(sheets_have_the_same_bytes_on_any_number_of_threads)
{
    struct gsn_image *alone[16] = { NULL }, *together[16] = { NULL };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_parallel_for(16, 1, draw_one, alone, &err), err);
    CHECK_OK(gsn_parallel_for(16, 4, draw_one, together, &err), err);
    for (int i = 0; i < 16; i++) {
        CHECK(alone[i]->width == together[i]->width && alone[i]->height == together[i]->height);
        CHECK(memcmp(alone[i]->samples, together[i]->samples, gsn_image_bytes(alone[i])) == 0);
        gsn_image_free(alone[i]);
        gsn_image_free(together[i]);
    }
}

/* Pango's own thread, slowed down where it has found a font, has said so, and is still at what it
 * was asked: it gives back the configuration, looks into the map's tables, and lets go of the map.
 */
static atomic_int slow, taken, taken_early;

void FcConfigDestroy(FcConfig *config)
{
    void (*real)(FcConfig *);

    *(void **)&real = dlsym(RTLD_NEXT, "FcConfigDestroy");
    real(config);
    if (atomic_load(&slow) && syscall(SYS_gettid) != getpid())
        (void)usleep(5000);
}

void pango_fc_font_map_set_config(PangoFcFontMap *map, FcConfig *config)
{
    void (*real)(PangoFcFontMap *, FcConfig *);

    *(void **)&real = dlsym(RTLD_NEXT, "pango_fc_font_map_set_config");
    if (!config) {
        atomic_fetch_add(&taken, 1);
        atomic_fetch_add(&taken_early, g_atomic_int_get((gint *)&G_OBJECT(map)->ref_count) > 1);
    }
    real(map, config);
}

/* Else that thread looks into tables that are gone: it divides by zero, or spins for ever. */
TEST(nothing_is_taken_from_a_map_that_pangos_thread_still_holds)
{
    atomic_store(&slow, 1);
    for (int i = 0; i < 10; i++) {
        gsn_auto(gsn_lettering) letters = open_letters();

        CHECK(gsn_lettering_width(letters, i % 2 ? GSN_FACE_BOLD : GSN_FACE_PLAIN, 12, "mm") > 0);
    }
    atomic_store(&slow, 0);
    CHECK(atomic_load(&taken) >= 10);
    CHECK(atomic_load(&taken_early) == 0);
}

static int open_once(struct gsn_error *err)
{
    gsn_auto(gsn_lettering) letters = NULL;

    return gsn_lettering_new(GSN_FONT_FOLDER, &letters, err);
}

static int mount_once(struct gsn_error *err)
{
    const struct gsn_plate plate = { .title = "cut",
                                     .note = "z = 3",
                                     .unit = "density",
                                     .um_per_px = 4.0,
                                     .has_scale = 1,
                                     .low = 0.0,
                                     .high = 1.0 };
    gsn_auto(gsn_image) image = NULL;
    int x, y;

    return gsn_plate_new(&plate, 60, 40, &image, &x, &y, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(open_once(&err), err);
    CHECK_EVERY_OOM(mount_once(&err), err);
}
