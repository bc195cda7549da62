/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/tetgen_wire.h"

#include <string.h>

#include "tests/check.h"
#include "tests/model/test_domain_shapes.h"

static struct gsn_soup *two_tets(void)
{
    static const double VERTEX[5][3] = {
        { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 }, { -0.1, 1e300, 1.0 / 3 }
    };
    static const uint32_t TET[2][4] = { { 0, 1, 2, 3 }, { 1, 2, 3, 4 } };
    struct gsn_soup *soup = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_soup_new(5, 2, &soup, &err), err);
    memcpy(soup->vertex, VERTEX, sizeof VERTEX);
    memcpy(soup->tet, TET, sizeof TET);
    return soup;
}

static void check_same(const struct gsn_soup *a, const struct gsn_soup *b)
{
    CHECK(a->vertex_count == b->vertex_count && a->tet_count == b->tet_count);
    CHECK(memcmp(a->vertex, b->vertex, a->vertex_count * sizeof *a->vertex) == 0);
    CHECK(memcmp(a->tet, b->tet, a->tet_count * sizeof *a->tet) == 0);
}

TEST(a_surface_question_survives_the_way)
{
    gsn_auto(gsn_surface) cube = shape_cube(3);
    const struct gsn_mesh_question asked = { .options = { 1.5, 1.4, 12 }, .surface = cube };
    struct gsn_mesh_question heard = { .surface = NULL };
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_mesh_question_pack(&asked, &bytes, &size, &err), err);
    CHECK_OK(gsn_mesh_question_unpack(bytes, size, &heard, &err), err);
    CHECK(heard.surface != NULL);
    CHECK(memcmp(&heard.options, &asked.options, sizeof asked.options) == 0);
    CHECK(memcmp(heard.surface->vertex, cube->vertex, 8 * sizeof *cube->vertex) == 0);
    CHECK(memcmp(heard.surface->facet, cube->facet, 6 * sizeof *cube->facet) == 0);
    gsn_mesh_question_done(&heard);
}

TEST(an_answer_and_a_refusal_survive_the_way)
{
    gsn_auto(gsn_soup) soup = two_tets();
    gsn_auto(gsn_soup) heard = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(uint8_t) refusal = NULL;
    struct gsn_error why = { 0 }, err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_mesh_answer_pack(soup, &bytes, &size, &err), err);
    CHECK_OK(gsn_mesh_answer_unpack(bytes, size, &heard, &err), err);
    check_same(heard, soup);
    gsn_soup_free(gsn_steal(&heard));

    (void)gsn_fail(&why, GSN_E_MESH, "facets %d and %d cross", 3, 4);
    CHECK_OK(gsn_mesh_refusal_pack(&why, &refusal, &size, &err), err);
    CHECK(gsn_mesh_answer_unpack(refusal, size, &heard, &err) == GSN_E_MESH);
    CHECK(strcmp(err.text, "facets 3 and 4 cross") == 0);
    CHECK(heard == NULL);
}

TEST(the_bytes_are_little_endian)
{
    gsn_auto(gsn_soup) soup = two_tets();
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_mesh_answer_pack(soup, &bytes, &size, &err), err);
    CHECK(size == 8 + 3 * 8 + 5 * 24 + 2 * 16);
    CHECK(memcmp(bytes, "gsnmesh1\5\0\0\0\0\0\0\0\0\0\0\0\0\0\0\0\2\0\0\0\0\0\0\0", 32) == 0);
    /* 1.0 is 0x3FF0000000000000. */
    CHECK(memcmp(bytes + 32 + 24, "\0\0\0\0\0\0\xf0\x3f", 8) == 0);
}

/* Every cut, every growth and every foreign start is refused; the outputs stay untouched. */
TEST(damaged_messages_are_refused)
{
    gsn_auto(gsn_soup) soup = two_tets();
    gsn_auto(gsn_surface) cube = shape_cube(3);
    const struct gsn_mesh_question asked = { .surface = cube };
    struct gsn_mesh_question question = { .surface = NULL };
    gsn_auto(gsn_soup) answer = NULL;
    gsn_auto_mem(uint8_t) asked_bytes = NULL;
    gsn_auto_mem(uint8_t) answer_bytes = NULL;
    struct gsn_error err = { 0 };
    size_t asked_size = 0, answer_size = 0;

    CHECK_OK(gsn_mesh_question_pack(&asked, &asked_bytes, &asked_size, &err), err);
    CHECK_OK(gsn_mesh_answer_pack(soup, &answer_bytes, &answer_size, &err), err);
    for (size_t size = 0; size < asked_size; size++) {
        gsn_auto_mem(uint8_t) cut = gsn_memdup(asked_bytes, size);

        CHECK(gsn_mesh_question_unpack(cut, size, &question, &err) == GSN_E_INPUT);
    }
    for (size_t size = 0; size < answer_size; size++) {
        gsn_auto_mem(uint8_t) cut = gsn_memdup(answer_bytes, size);

        CHECK(gsn_mesh_answer_unpack(cut, size, &answer, &err) == GSN_E_MESH);
    }
    CHECK(gsn_mesh_question_unpack(answer_bytes, answer_size, &question, &err) == GSN_E_INPUT);
    CHECK(gsn_mesh_answer_unpack(asked_bytes, asked_size, &answer, &err) == GSN_E_MESH);
    memset(asked_bytes + 8, 0xFF, 24); /* counts whose sizes overflow */
    CHECK(gsn_mesh_question_unpack(asked_bytes, asked_size, &question, &err) == GSN_E_INPUT);
    CHECK(question.surface == NULL && answer == NULL);
}

static int way_once(const struct gsn_mesh_question *asked, const struct gsn_soup *mesh,
                    struct gsn_error *err)
{
    struct gsn_mesh_question heard = { .surface = NULL };
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(uint8_t) answer = NULL;
    gsn_auto(gsn_soup) soup = NULL;
    size_t size = 0;
    int r = gsn_mesh_question_pack(asked, &bytes, &size, err);

    if (r >= 0)
        r = gsn_mesh_question_unpack(bytes, size, &heard, err);
    if (r >= 0)
        r = gsn_mesh_answer_pack(mesh, &answer, &size, err);
    if (r >= 0)
        r = gsn_mesh_answer_unpack(answer, size, &soup, err);
    gsn_mesh_question_done(&heard);
    return r;
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_soup) soup = two_tets();
    gsn_auto(gsn_surface) cube = shape_cube(3);
    const struct gsn_mesh_question asked = { .surface = cube };
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(way_once(&asked, soup, &err), err);
}
