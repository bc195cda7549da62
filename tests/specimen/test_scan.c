/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/scan.h"

#include "pipeline/decode/png_write.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/stain_vectors.h"
#include "tests/check.h"
#include "tests/decode/make.h"
#include "tests/specimen/drawn_specimen.h"

#include <lcms2.h>
#include <string.h>

#define PX "\"specimen\": \"x\", \"px_um\": 24"

static struct made drawn_png(int srgb, const struct png_recipe *recipe)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    panel.srgb = srgb;
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);

    return make_png(image, recipe);
}

static int open_as(const struct made *png, const char *job, struct gsn_scan **ret_scan,
                   struct gsn_error *err)
{
    gsn_auto(gsn_protocol) protocol = drawn_protocol(job);

    return gsn_scan_open(NULL, gsn_check_fd(png->bytes, png->size), protocol, NULL, ret_scan, err);
}

static struct gsn_scan *opened(const struct made *png, const char *job)
{
    struct gsn_scan *scan = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(open_as(png, job, &scan, &err), err);
    return scan;
}

/* Case 13. The job decides, then the file; where neither says, codes are taken as light, and that
 * is noted.
 */
TEST(light_is_what_the_job_says_then_what_the_file_says_then_noted)
{
    static const struct {
        struct png_recipe file;
        const char *job;
        enum gsn_light light;
        const char *note; /* "" : none */
    } cases[] = {
        { { 0 }, "{" PX "}", GSN_LIGHT_CODES_LINEAR, "transfer curve not stated" },
        { { 0 }, "{" PX ", \"transfer\": \"linear\"}", GSN_LIGHT_CODES_LINEAR, "" },
        { { 0 }, "{" PX ", \"transfer\": \"srgb\"}", GSN_LIGHT_SRGB, "" },
        { { .srgb = 1 }, "{" PX "}", GSN_LIGHT_SRGB, "" },
        { { .srgb = 1 }, "{" PX ", \"transfer\": \"unknown\"}", GSN_LIGHT_SRGB, "" },
        { { .srgb = 1 }, "{" PX ", \"transfer\": \"linear\"}", GSN_LIGHT_CODES_LINEAR, "" },
        { { .gamma = 100000 }, "{" PX "}", GSN_LIGHT_CODES_LINEAR, "" },
        { { .gamma = 100000 }, "{" PX ", \"transfer\": \"srgb\"}", GSN_LIGHT_SRGB, "" },
        { { .with_icc = 1 },
          "{" PX "}",
          GSN_LIGHT_SRGB,
          "its ICC profile is read as sRGB: it cannot be read" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        auto_made png = drawn_png(0, &cases[i].file);
        gsn_auto(gsn_scan) scan = opened(&png, cases[i].job);

        if (scan->glass.light != cases[i].light)
            fail_msg("case %zu: light %d", i, (int)scan->glass.light);
        if (cases[i].note[0] ? !strstr(scan->note, cases[i].note) : scan->note[0] != '\0')
            fail_msg("case %zu notes: %s", i, scan->note);
    }
}

/* The same amounts of dye behind both curves give the same optical density. */
TEST(a_file_coded_by_srgb_has_the_densities_of_one_in_proportion_to_light)
{
    auto_made straight = drawn_png(0, &(struct png_recipe){ .gamma = 100000 });
    auto_made curved = drawn_png(1, &(struct png_recipe){ .srgb = 1 });
    gsn_auto(gsn_scan) a = opened(&straight, "{" PX "}");
    gsn_auto(gsn_scan) b = opened(&curved, "{" PX "}");
    double worst = 0;

    for (size_t c = 0; c < 3; c++)
        for (size_t i = 0; i < (size_t)a->od[c]->width * a->od[c]->height; i++)
            worst = fmax(worst, fabs((double)(a->od[c]->value[i] - b->od[c]->value[i])));
    CHECK_NEAR(worst, 0, 0.02); /* rounding of the darkest pixels, the marks */
}

/* gives: what Little CMS writes for three curves of this gamma. */
static struct made profile_of(double gamma)
{
    cmsToneCurve *curve = cmsBuildGamma(NULL, gamma);
    cmsToneCurve *const curves[3] = { curve, curve, curve };
    const cmsCIExyY white = { 0.3127, 0.3290, 1 };
    const cmsCIExyYTRIPLE primaries = { { 0.64, 0.33, 1 }, { 0.30, 0.60, 1 }, { 0.15, 0.06, 1 } };
    cmsHPROFILE profile = cmsCreateRGBProfile(&white, &primaries, curves);
    cmsUInt32Number size = 0;
    struct made made;

    CHECK(cmsSaveProfileToMem(profile, NULL, &size));
    made = (struct made){ gsn_alloc_array(size, 1), size };
    CHECK(cmsSaveProfileToMem(profile, made.bytes, &size));
    (void)cmsCloseProfile(profile);
    cmsFreeToneCurve(curve);
    return made;
}

/* Case 13. Codes that were drawn in proportion to light, taken as gamma 1.8, are light to the power
 * of 1.8: every density is 1.8 times what it was. */
TEST(a_profile_is_undone_named_and_overruled_by_the_job)
{
    struct made profile = profile_of(1.8);
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_image) image = drawn_panel_image(&panel);
    auto_made tiff = make_tiff(image, &(struct tiff_recipe){ .icc = &profile });
    gsn_auto(gsn_scan) plain = opened(&tiff, "{" PX ", \"transfer\": \"linear\"}");
    gsn_auto(gsn_scan) light = opened(&tiff, "{" PX "}");
    const size_t at = (size_t)60 * image->width + 54;

    CHECK(plain->glass.light == GSN_LIGHT_CODES_LINEAR && plain->note[0] == '\0');
    CHECK(light->glass.light == GSN_LIGHT_PROFILE);
    CHECK(strstr(light->note, "samples turned into linear light by its profile \"") != NULL);
    for (int c = 0; c < 3; c++) {
        CHECK(plain->od[c]->value[at] > 0.1F);
        CHECK_NEAR(light->od[c]->value[at] / plain->od[c]->value[at], 1.8, 0.02);
    }
    gsn_free(profile.bytes);
}

/* Case 14. */
TEST(the_pixel_size_is_the_jobs_else_the_files)
{
    /* 1/24 um is 41667 pixels per metre. */
    auto_made right = drawn_png(0, &(struct png_recipe){ .gamma = 100000, .per_metre = 41667 });
    auto_made wrong = drawn_png(0, &(struct png_recipe){ .gamma = 100000, .per_metre = 2835 });
    gsn_auto(gsn_scan) stated = opened(&right, "{" PX "}");
    gsn_auto(gsn_scan) tagged = opened(&right, "{\"specimen\": \"x\"}");
    gsn_auto(gsn_scan) doubted = opened(&wrong, "{" PX "}");

    CHECK_NEAR(stated->px_um, 24, 0);
    CHECK(stated->note[0] == '\0');
    CHECK_NEAR(tagged->px_um, 24, 1e-3);
    CHECK_NEAR(doubted->px_um, 24, 0);
    CHECK(strstr(doubted->note, "the file states pixels of 352.7 x 352.7 um") != NULL);
}

TEST(the_glass_is_measured_and_the_tissue_is_dense)
{
    auto_made png = drawn_png(0, &(struct png_recipe){ .gamma = 100000 });
    gsn_auto(gsn_scan) scan = opened(&png, "{" PX "}");
    const double green_od = 0.62 * 0.8 * 0.716 / hypot(hypot(.239, .716), .655) +
                            0.34 * 0.56 * 0.326 / hypot(hypot(.357, .326), .875);
    const struct gsn_plane *green = scan->od[1];

    CHECK_NEAR(scan->glass.white[0], 248, 0.5);
    CHECK_NEAR(scan->glass.white[1], 244, 0.5);
    CHECK_NEAR(scan->glass.white[2], 238, 0.5);
    CHECK_NEAR(scan->glass.fraction, 1 - M_PI * 1000 * 800 / (2600.0 * 2600), 0.05);
    CHECK_NEAR((double)green->value[54 * green->width + 54], green_od, 0.02);
    CHECK_NEAR((double)green->value[0], 0, 0.005);
}

TEST(a_stated_white_is_used_and_noted)
{
    auto_made png = drawn_png(0, &(struct png_recipe){ .gamma = 100000 });
    gsn_auto(gsn_scan) scan = opened(&png, "{" PX ", \"white\": [1, 0.9, 0.8]}");

    CHECK_NEAR(scan->glass.white[0], 255, 1e-6);
    CHECK_NEAR(scan->glass.white[1], 229.5, 1e-6);
    CHECK_NEAR(scan->glass.white[2], 204, 1e-6);
    CHECK(strstr(scan->note, "white point as stated in the job, not measured") != NULL);
}

/* A picture without glass: one even tissue. */
static struct made full_tissue(uint32_t channels)
{
    gsn_auto(gsn_image) image = make_picture(64, 64, channels, 8);

    for (size_t i = 0; channels == 3 && i < gsn_image_bytes(image); i++)
        ((uint8_t *)image->samples)[i] = (uint8_t)(90 + i % 97);
    return make_png(image, &(struct png_recipe){ 0 });
}

TEST(a_picture_that_cannot_be_used_is_refused_with_its_reason)
{
    auto_made good = drawn_png(0, &(struct png_recipe){ 0 });
    auto_made grey = full_tissue(1);
    auto_made tissue = full_tissue(3);
    const struct made cut = { good.bytes, good.size / 2 };
    const struct {
        const struct made *file;
        const char *job;
        int code;
        const char *says;
    } cases[] = {
        { &good, "{\"specimen\": \"x\"}", GSN_E_INPUT, "the pixel size is not known" },
        { &grey, "{" PX "}", GSN_E_INPUT, "a grey picture" },
        { &tissue, "{" PX "}", GSN_E_STAIN, "glass" },
        { &cut, "{" PX "}", GSN_E_INPUT, "" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct gsn_scan *scan = NULL;
        struct gsn_error err = { 0 };
        const int r = open_as(cases[i].file, cases[i].job, &scan, &err);

        if (r != cases[i].code || !err.text[0] || !strstr(err.text, cases[i].says))
            fail_msg("case %zu: %d (%s)", i, r, err.text);
        CHECK(scan == NULL);
    }
}

TEST(built_in_dyes_serve_the_light_they_were_measured_in_and_no_other)
{
    auto_made png = drawn_png(0, &(struct png_recipe){ .gamma = 100000 });
    gsn_auto(gsn_protocol) builtin = drawn_protocol("{" PX "}");
    gsn_auto(gsn_protocol) estimate = drawn_protocol("{" PX ", \"dyes\": \"estimate\"}");
    gsn_auto(gsn_scan) scan = opened(&png, "{" PX "}");
    struct gsn_dyes_fit fit = { .deviation_deg = { -1, -1, -1 } };
    struct gsn_error err = { 0 };
    int r;

    CHECK_OK(gsn_scan_dyes(scan, NULL, builtin, &fit, &err), err);
    CHECK(strcmp(fit.dyes.name, gsn_dyes_builtin().name) == 0);
    CHECK(fit.deviation_deg[0] == 0 && fit.deviation_deg[2] == 0);
    /* These sections have one density, so they cannot say what red and yellow are by themselves:
     * estimated or refused, they are not the built-in vectors. */
    r = gsn_scan_dyes(scan, NULL, estimate, &fit, &err);
    CHECK(r == GSN_E_STAIN || strcmp(fit.dyes.name, gsn_dyes_builtin().name) != 0);
}

TEST(built_in_dyes_that_the_job_states_are_obeyed_in_any_light_and_noted)
{
    static const char stated[] = "{" PX ", \"dyes\": \"builtin\", \"transfer\": \"srgb\"}";
    auto_made png = drawn_png(0, &(struct png_recipe){ .srgb = 1 });
    gsn_auto(gsn_protocol) protocol = drawn_protocol(stated);
    gsn_auto(gsn_scan) scan = opened(&png, stated);
    gsn_auto(gsn_scan) unsaid = opened(&png, "{" PX ", \"transfer\": \"srgb\"}");
    const struct gsn_dyes builtin = gsn_dyes_builtin();
    struct gsn_dyes_fit fit = { .deviation_deg = { -1, -1, -1 } };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scan_dyes(scan, NULL, protocol, &fit, &err), err);
    CHECK(strcmp(fit.dyes.name, builtin.name) == 0 && fit.dyes.light == GSN_LIGHT_SRGB);
    CHECK(memcmp(fit.dyes.red, builtin.red, sizeof builtin.red) == 0);
    CHECK(strstr(scan->note, "the built-in dye vectors are used as the job states"));
    CHECK(!strstr(unsaid->note, "built-in dye vectors"));
}

struct oom {
    const struct made *png;
    const struct gsn_protocol *protocol;
};

static int open_once(const struct oom *oom, struct gsn_error *err)
{
    gsn_auto(gsn_scan) scan = NULL;

    return gsn_scan_open(NULL, gsn_check_fd(oom->png->bytes, oom->png->size), oom->protocol, NULL,
                         &scan, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    auto_made png = drawn_png(0, &(struct png_recipe){ 0 });
    gsn_auto(gsn_protocol) protocol = drawn_protocol("{" PX "}");
    const struct oom oom = { &png, protocol };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(open_once(&oom, &err), err);
}

/* Case 7. A frame of a camera that could not be locked may be looked at, never measured. */
TEST(a_picture_whose_camera_was_not_locked_is_refused_aloud)
{
    static const char head[] = "P7\n# gieson frame 1\n# not to be measured: gain is not locked: it "
                               "is automatic\nWIDTH 2\nHEIGHT 1\nDEPTH 3\nMAXVAL 255\n"
                               "TUPLTYPE RGB\nENDHDR\nabcdef";
    struct made frame = { (uint8_t *)(uintptr_t)head, sizeof head - 1 };
    struct gsn_scan *scan = NULL;
    struct gsn_error err = { 0 };

    CHECK(open_as(&frame, "{" PX "}", &scan, &err) == GSN_E_STAIN);
    CHECK(scan == NULL);
    CHECK(strstr(err.text, "must not be measured (gain is not locked: it is automatic)") != NULL);
    CHECK(strstr(err.text, "lock the camera and take the panel again") != NULL);
}
