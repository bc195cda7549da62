/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/uvc.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/file.h"
#include "tests/check.h"

enum { MOST_BYTES = 65536 };

struct set {
    uint8_t *bytes;
    size_t size;
};

static void set_free(struct set *set)
{
    gsn_free(set->bytes);
}

#define auto_set __attribute__((cleanup(set_free))) struct set

static struct set read_set(const char *name, const char *ending)
{
    struct set set = { 0 };
    struct gsn_error err = { 0 };
    char path[400];

    (void)snprintf(path, sizeof path, "%s/device/%s.%s", GSN_FIXTURES, name, ending);
    CHECK_OK(gsn_file_read(path, MOST_BYTES, &set.bytes, &set.size, &err), err);
    return set;
}

static struct gsn_uvc *parse(const struct set *set)
{
    struct gsn_uvc *uvc = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_uvc_parse(set->bytes, set->size, &uvc, &err), err);
    return uvc;
}

static const struct {
    const char *name;
    uint16_t vendor, product, version;
    size_t sizes;
    bool is_bulk;
    const char *unlockable; /* by the control bits of the listing */
} cameras[] = {
    { "logitech_c270", 0x046d, 0x0825, 0x0100, 38, false, "" },
    { "anker_powerconf_c200", 0x291a, 0x3369, 0x0110, 15, false, "no gain" },
    { "canyon_cne_cwc2", 0x0c45, 0x6340, 0x0100, 18, false,
      "no gain; no white balance; its automatic white balance cannot be switched off" },
    { "dual_tusb", 0x303a, 0x8000, 0x0150, 2, true,
      "its automatic exposure cannot be switched off; no exposure time; no gain; no white balance; "
      "its automatic white balance cannot be switched off" },
};

enum { CAMERAS = sizeof cameras / sizeof cameras[0] };

TEST(real_cameras_list_the_sizes_that_their_listings_show)
{
    for (size_t i = 0; i < CAMERAS; i++) {
        auto_set set = read_set(cameras[i].name, "descriptors");
        auto_set listing = read_set(cameras[i].name, "sizes");
        gsn_auto(gsn_uvc) uvc = parse(&set);
        gsn_auto_mem(char) text = gsn_alloc_array(uvc->size_count + 1, 32);
        size_t used = 0;

        CHECK(uvc->vendor == cameras[i].vendor && uvc->product == cameras[i].product);
        CHECK(uvc->version == cameras[i].version && uvc->size_count == cameras[i].sizes);
        CHECK((uvc->is_bulk != 0) == cameras[i].is_bulk);
        for (size_t k = 0; k < uvc->size_count; k++)
            used += (size_t)snprintf(text + used, 32, "%s %ux%u\n",
                                     uvc->format[uvc->size[k].format].name, uvc->size[k].width,
                                     uvc->size[k].height);
        if (strcmp(text, (const char *)listing.bytes) != 0)
            fail_msg("%s lists\n%s", cameras[i].name, text);
    }
}

TEST(it_is_known_beforehand_which_cameras_can_be_locked)
{
    for (size_t i = 0; i < CAMERAS; i++) {
        auto_set set = read_set(cameras[i].name, "descriptors");
        gsn_auto(gsn_uvc) uvc = parse(&set);
        char reason[300];

        CHECK(gsn_uvc_can_be_locked(uvc, reason, sizeof reason) == !cameras[i].unlockable[0]);
        if (strcmp(reason, cameras[i].unlockable) != 0)
            fail_msg("%s: %s", cameras[i].name, reason);
    }
}

/* The first YUY2 size of the C270: 640 x 480, at best 30 frames a second. */
TEST(the_shortest_interval_is_found)
{
    auto_set set = read_set("logitech_c270", "descriptors");
    gsn_auto(gsn_uvc) uvc = parse(&set);

    CHECK(uvc->size[0].width == 640 && uvc->size[0].height == 480);
    CHECK(uvc->size[0].shortest == 333333);
    CHECK(uvc->is_isochronous && !uvc->is_bulk);
}

static void refuses(const struct set *set, int code, const char *sentence)
{
    struct gsn_uvc *uvc = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_uvc_parse(set->bytes, set->size, &uvc, &err) == code && uvc == NULL);
    if (!strstr(err.text, sentence))
        fail_msg("\"%s\" does not say \"%s\"", err.text, sentence);
}

TEST(what_is_no_camera_or_cut_short_is_refused_with_the_reason)
{
    auto_set set = read_set("logitech_c270", "descriptors");
    uint8_t *const config = set.bytes + 18;

    for (size_t size = 0; size < set.size; size++) {
        const struct set cut = { set.bytes, size };

        refuses(&cut, GSN_E_INPUT, size < 27 ? "at the beginning" : "bytes, ");
    }
    /* The header of the control interface is the first class-specific descriptor. */
    for (size_t at = 18 + 9; at < set.size; at += set.bytes[at]) {
        if (set.bytes[at + 1] == 4)
            set.bytes[at + 5] = 3; /* an input device */
    }
    refuses(&set, GSN_E_UNSUPPORTED, "046d:0825 is no camera");
    config[9] = 0;
    refuses(&set, GSN_E_INPUT, "the descriptor at byte 27 states 0 bytes");
}

TEST(a_format_that_lists_other_sizes_than_it_states_is_refused)
{
    auto_set set = read_set("canyon_cne_cwc2", "descriptors");

    for (size_t at = 18; at < set.size; at += set.bytes[at]) {
        if (set.bytes[at + 1] != 0x24 || set.bytes[at + 2] != 4)
            continue;
        set.bytes[at + 4]++;
        refuses(&set, GSN_E_INPUT, "format YUY2 of interface 1 states 10 sizes and lists 9");
        set.bytes[at + 4] = 3;
        refuses(&set, GSN_E_INPUT, "one more than that states");
        return;
    }
    fail();
}

/* Mutated sets are parsed or refused; the sanitizers see to the rest. Copies of exactly the size,
 * so that one byte too far is seen. */
TEST(mutated_sets_are_parsed_or_refused)
{
    unsigned seed = 1, parsed = 0;

    for (size_t i = 0; i < CAMERAS; i++) {
        auto_set set = read_set(cameras[i].name, "descriptors");

        for (unsigned n = 0; n < 25000; n++) {
            const size_t size = n % 5 ? set.size : (seed >> 3) % set.size;
            uint8_t *const copy = malloc(size ? size : 1);
            gsn_auto(gsn_uvc) uvc = NULL;
            struct gsn_error err = { 0 };
            char reason[64];
            int r;

            CHECK(copy != NULL);
            memcpy(copy, set.bytes, size);
            if (n % 5 == 0 && size >= 22) { /* cut, and the length says so */
                copy[20] = (uint8_t)(size - 18);
                copy[21] = (uint8_t)((size - 18) >> 8);
            }
            for (unsigned k = 0; k < n % 6 && size; k++) {
                seed = seed * 1664525U + 1013904223U;
                copy[(seed >> 8) % size] = (uint8_t)(seed >> 24);
            }
            seed = seed * 1664525U + 1013904223U;
            r = gsn_uvc_parse(copy, size, &uvc, &err);
            CHECK(r == GSN_OK ? uvc != NULL : uvc == NULL && err.text[0]);
            if (uvc)
                (void)gsn_uvc_can_be_locked(uvc, reason, sizeof reason);
            parsed += r == GSN_OK;
            free(copy);
        }
    }
    CHECK(parsed > 1000);
}

static int parse_once(const struct set *set, struct gsn_error *err)
{
    gsn_auto(gsn_uvc) uvc = NULL;

    return gsn_uvc_parse(set->bytes, set->size, &uvc, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    auto_set set = read_set("logitech_c270", "descriptors");
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(parse_once(&set, &err), err);
}
