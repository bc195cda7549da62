/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* TetGen 1.5 behind one question (H. Si, "TetGen, a Delaunay-based quality tetrahedral mesh
 * generator", ACM Trans. Math. Softw. 41, 2015).
 *
 * Steps: (1) the options are in range; (2) surface or mesh into tetgenio, whose arrays it frees
 * with delete[]; (3) its switches: p (a surface) or r (refine a mesh), q (radius-edge ratio and
 * dihedral angle), a (volume), Y where facets must stay whole; (4) what it made is copied out,
 * unverified.
 *
 * Failure: TetGen throws its exit status; the sentence says what that stands for. A crash or a loop
 * is the caller's to survive. Cost: TetGen's. */
#include "pipeline/model/tetgen_bridge.h"

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstdio>
#include <memory>
#include <new>

/* TetGen 1.5.0 frees its mesh before it throws and again while unwinding. Its function is a weak
 * symbol: ours, in the same file as the call, wins and leaves the freeing to the unwinding. */
#define TETLIBRARY
#define terminatetetgen terminatetetgen_as_shipped
#include <tetgen.h>
#undef terminatetetgen
[[gnu::visibility("default")]] void terminatetetgen(tetgenmesh *, int reason);
void terminatetetgen(tetgenmesh *, int reason)
{
    throw reason;
}

namespace
{

struct free_soup {
    void operator()(gsn_soup *soup) const
    {
        gsn_soup_free(soup);
    }
};

int checked_int(size_t count)
{
    if (count > INT_MAX / 4)
        throw std::bad_alloc();
    return static_cast<int>(count);
}

void fill_points(tetgenio &in, const double (*vertex)[3], size_t count)
{
    in.firstnumber = 0;
    in.pointlist = new REAL[3 * count];
    in.numberofpoints = checked_int(count);
    std::copy(&vertex[0][0], &vertex[0][0] + 3 * count, in.pointlist);
}

/* tetgenio frees with delete[], and facets only as far as they were initialised. */
void fill_facets(tetgenio &in, const gsn_surface &surface)
{
    const size_t count = surface.facet_count + surface.inner_count;

    in.facetlist = new tetgenio::facet[count];
    for (size_t f = 0; f < count; f++)
        tetgenio::init(&in.facetlist[f]);
    in.numberoffacets = checked_int(count);
    for (size_t f = 0; f < count; f++) {
        const size_t corners = gsn_surface_corners(&surface, f);
        tetgenio::facet &facet = in.facetlist[f];

        facet.polygonlist = new tetgenio::polygon[1];
        tetgenio::init(facet.polygonlist);
        facet.numberofpolygons = 1;
        facet.polygonlist->vertexlist = new int[corners];
        facet.polygonlist->numberofvertices = static_cast<int>(corners);
        std::copy(surface.facet[f], surface.facet[f] + corners, facet.polygonlist->vertexlist);
    }
}

std::unique_ptr<gsn_soup, free_soup> copy_out(const tetgenio &out)
{
    gsn_soup *soup = nullptr;

    if (gsn_soup_new(static_cast<size_t>(out.numberofpoints),
                     static_cast<size_t>(out.numberoftetrahedra), &soup, nullptr) < 0)
        throw std::bad_alloc();
    std::copy(out.pointlist, out.pointlist + 3 * soup->vertex_count, &soup->vertex[0][0]);
    std::copy(out.tetrahedronlist, out.tetrahedronlist + 4 * soup->tet_count, &soup->tet[0][0]);
    return std::unique_ptr<gsn_soup, free_soup>(soup);
}

bool in_range(const gsn_tetgen_options &options)
{
    return std::isfinite(options.max_tet_um3) && options.max_tet_um3 >= 0 &&
           options.radius_edge >= 1.1 && options.radius_edge <= 10 &&
           options.min_dihedral_deg >= 0 && options.min_dihedral_deg <= 18;
}

/* p: a surface; q: quality; a: largest volume; Y: facets stay as they are, so that no vertex leaves
 * the surface that inner ones stand for. */
void switches(const gsn_mesh_question &question, char *text, size_t room)
{
    const gsn_tetgen_options &options = question.options;
    const int length =
        std::snprintf(text, room, "pq%.6f/%.6f%sQ", options.radius_edge, options.min_dihedral_deg,
                      question.surface->inner_count > 0 ? "Y" : "");

    if (options.max_tet_um3 > 0)
        std::snprintf(text + length, room - static_cast<size_t>(length), "a%.17g",
                      options.max_tet_um3);
}

const char *reason_words(int reason)
{
    switch (reason) {
    case 2:
        return "an internal error";
    case 3:
        return "the surface crosses itself";
    case 4:
        return "a feature is too small";
    case 5:
        return "two facets are too close";
    default:
        return "the input is wrong";
    }
}

} // namespace

int gsn_tetgen_mesh(const struct gsn_mesh_question *question, struct gsn_soup **ret_mesh,
                    struct gsn_error *err)
try {
    tetgenio in, out;
    tetgenbehavior behaviour;
    char text[128];

    if (!in_range(question->options))
        return gsn_fail(
            err, GSN_E_INPUT,
            "the mesher's options are out of range: tetrahedra of at most %g um3 (0 or "
            "more), a radius-edge ratio of %g (1.1 to 10), dihedral angles of %g degrees "
            "(0 to 18)",
            question->options.max_tet_um3, question->options.radius_edge,
            question->options.min_dihedral_deg);
    fill_points(in, question->surface->vertex, question->surface->vertex_count);
    fill_facets(in, *question->surface);
    switches(*question, text, sizeof text);
    if (!behaviour.parse_commandline(text))
        return gsn_fail(err, GSN_E_INPUT, "TetGen does not know the switches %s", text);
    tetrahedralize(&behaviour, &in, &out);
    if (out.numberoftetrahedra <= 0 || out.numberofcorners != 4)
        return gsn_fail(err, GSN_E_MESH, "TetGen found nothing to fill");
    *ret_mesh = copy_out(out).release();
    return GSN_OK;
} catch (const std::bad_alloc &) {
    return gsn_fail(err, GSN_E_NOMEM, "out of memory while meshing");
} catch (int reason) { /* TetGen throws its exit status */
    if (reason == 1)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while meshing");
    return gsn_fail(err, GSN_E_MESH, "TetGen gave up: %s (reason %d)", reason_words(reason),
                    reason);
} catch (...) {
    return gsn_fail(err, GSN_E_MESH, "TetGen gave up");
}
