/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is handed on of sections that are held, so that a second mount of one can be told. */
#include "pipeline/specimen/section_order.h"
#include "tests/check.h"
#include "tests/specimen/drawn_assembly.h"

/* The density in the middle of the section, as it was handed on. */
static struct seen {
    size_t calls, section;
    double middle, px_um;
    unsigned apart;
} seen;

int __real_gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                                   const struct gsn_plane *density, unsigned apart, double px_um,
                                   struct gsn_error *err);
int __wrap_gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                                   const struct gsn_plane *density, unsigned apart, double px_um,
                                   struct gsn_error *err);
int __wrap_gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                                   const struct gsn_plane *density, unsigned apart, double px_um,
                                   struct gsn_error *err)
{
    const uint32_t x = density->width / 2, y = density->height / 2;

    seen = (struct seen){ seen.calls + 1, i, density->value[(size_t)y * density->width + x], px_um,
                          apart };
    return __real_gsn_section_planes_hold(planes, i, density, apart, px_um, err);
}

/* Another mount of section 2 in the place of section 4, of half the density. */
TEST(a_held_section_is_handed_on_as_it_lies_and_no_other_is)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    drawn_three_panels(panels);
    panels[1].section[0].density = DRAWN_DENSITY / 2;
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    d.findings[1]->section[0].serial = 2;
    seen = (struct seen){ 0 };
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->densities.section[3].state == GSN_SECTION_HELD);
    CHECK(seen.calls == 1 && seen.section == 3);
    CHECK_NEAR(seen.middle, DRAWN_DENSITY / 2, 0.02 * DRAWN_DENSITY);
    CHECK_NEAR(seen.px_um, 24, 1e-9);
    CHECK(seen.apart == 1); /* pixels of 24 um are coarser than what rows may lack */
}

/* A slot that was held for what is wrong with it may have no box. */
TEST(a_held_slot_without_a_box_is_passed_over)
{
    struct drawn_panel panels[3];
    drawn_auto d;

    drawn_three_panels(panels);
    drawn_specimen_init(&d, DRAWN_JOB, panels, 3);
    d.findings[1]->section[0].serial = 2;
    d.findings[1]->section[0].width = 0;
    seen = (struct seen){ 0 };
    gsn_auto(gsn_reconstruction) a = drawn_assembly(&d);

    CHECK(a->densities.section[3].state == GSN_SECTION_HELD);
    CHECK(seen.calls == 0);
}
