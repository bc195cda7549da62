/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The phantom block in closed form: collagen density at a point.
 *
 * Method: the block is a superellipse whose outline waves; the root a slanted elliptic paraboloid,
 * with the distance from it to first order (its value over the length of its gradient); ligament,
 * bone and surroundings are shells of that distance, marrow spaces are ellipsoids, every border a
 * cubic smooth step over delta on either side. The lesion is a Gaussian. The numbers are the two
 * tables; README.md says what each key of a variant changes.
 *
 * Steps of gsn_phantom_field_at(): (1) tissue or glass; (2) distance from the root; (3) shares of
 * the layers, which sum to 1; (4) lesion; (5) density as it was and what the lesion takes.
 *
 * Failure: none. Cost: constant; bounds of the outline and boxes around the marrow spaces spare
 * most points the powers and roots. */
#include "pipeline/phantom/geometry.h"

#include <math.h>
#include <string.h>

static const struct gsn_phantom_geometry GVP_D = {
    .sections = 60,
    .first_z = 12,
    .interval = 24,
    .height = 1440,
    .ax = 2600,
    .ay = 2050,
    .p = 3,
    .delta = 12,
    .a = 520,
    .b = 430,
    .root_length = 900,
    .apex_z = 250,
    .cx = -100,
    .cy = 80,
    .tx = 0.10,
    .ty = -0.06,
    .pulp_scale = 0.38,
    .pulp_start = 0.25,
    .pdl_width = 180,
    .bone_width = 700,
    .bone_wave = 0.25,
    .bone_turn = 0.6,
    .density = { [GSN_PHANTOM_CONN] = 0.20,
                 [GSN_PHANTOM_DENT] = 0.55,
                 [GSN_PHANTOM_PULP] = 0.12,
                 [GSN_PHANTOM_PDL] = 0.42,
                 [GSN_PHANTOM_BONE] = 0.88,
                 [GSN_PHANTOM_MARR] = 0.06 },
    .lamella = 0.05,
    .lamella_length = 80,
    .slope_z = 0.08,
    .lesion = { 411, 646, 420 },
    .lesion_radius = { 520, 420, 330 },
    .lesion_turn = 0.5,
    .lesion_in_pdl = 0.5,
    .region_depth = 450,
    .region_half_height = 300,
    .region_radius = 900,
    .outline = { { 2, .001, .33, -.000722 },
                 { 3, .003, 6.18, -.001243 },
                 { 4, .007, .37, .00035 },
                 { 5, .001, .43, -.00105 },
                 { 6, .005, 3.62, .000764 } },
    .marrow = { { { 45, 1351, 208 }, { 164, 94, 162 } },
                { { 1245, -272, 791 }, { 63, 143, 181 } },
                { { -647, 865, 437 }, { 110, 75, 159 } },
                { { -1127, -713, 1081 }, { 91, 113, 257 } },
                { { -848, -1018, 1397 }, { 117, 73, 196 } },
                { { 1051, 339, 1321 }, { 64, 118, 168 } },
                { { -1663, 424, 1228 }, { 125, 89, 233 } },
                { { -1338, 959, 984 }, { 147, 81, 226 } },
                { { -1173, -1255, 1232 }, { 155, 156, 170 } },
                { { 836, 1007, 406 }, { 84, 130, 227 } },
                { { 1500, -232, 849 }, { 63, 134, 246 } },
                { { 1242, 1157, 951 }, { 87, 145, 126 } },
                { { -1275, -375, 456 }, { 136, 80, 157 } },
                { { -1497, 399, 548 }, { 140, 132, 163 } },
                { { 1396, 396, 1167 }, { 98, 120, 123 } },
                { { 752, -1114, 542 }, { 106, 133, 168 } },
                { { 329, 1019, 1046 }, { 100, 109, 153 } },
                { { -706, -561, 830 }, { 167, 145, 224 } },
                { { 985, 291, 1321 }, { 136, 115, 103 } },
                { { -44, -862, 191 }, { 116, 146, 140 } },
                { { 1021, 77, 215 }, { 166, 104, 140 } },
                { { 1319, -1127, 1056 }, { 81, 103, 129 } },
                { { 1297, -330, 1404 }, { 129, 136, 179 } },
                { { -24, 1415, 411 }, { 142, 109, 126 } },
                { { 402, 918, 908 }, { 100, 144, 95 } },
                { { -1415, -832, 809 }, { 103, 147, 193 } },
                { { 1373, 697, 867 }, { 92, 146, 133 } },
                { { 1041, 88, 881 }, { 64, 81, 205 } },
                { { 268, -1024, 1371 }, { 77, 116, 114 } },
                { { 826, -671, 193 }, { 65, 79, 123 } },
                { { -1451, -419, 135 }, { 126, 89, 135 } },
                { { -804, -1207, 1067 }, { 132, 127, 96 } },
                { { -435, -1440, 118 }, { 84, 106, 169 } },
                { { -1398, -340, 488 }, { 156, 106, 104 } },
                { { -1470, -102, 133 }, { 129, 128, 95 } },
                { { 1168, 860, 1318 }, { 134, 136, 118 } },
                { { 554, 1341, 503 }, { 143, 67, 118 } },
                { { -847, 151, 803 }, { 115, 107, 188 } },
                { { 1773, -126, 1206 }, { 66, 102, 185 } },
                { { 457, -750, 575 }, { 164, 131, 189 } } },
    .mark = { { -2050, -1000 }, { 1700, -1500 }, { -1500, 1300 } },
    .marrows = GSN_PHANTOM_MARROWS,
};

/* A second animal, cut thicker: a deeper and narrower block, a stouter root that slants the other
 * way, a wider ligament, and a lesion on the opposite side. */
static const struct gsn_phantom_geometry GVP_P = {
    .sections = 48,
    .first_z = 15,
    .interval = 30,
    .height = 1440,
    .ax = 1900,
    .ay = 2300,
    .p = 2.6,
    .delta = 12,
    .a = 430,
    .b = 560,
    .root_length = 1100,
    .apex_z = 180,
    .cx = 220,
    .cy = -140,
    .tx = -0.08,
    .ty = 0.05,
    .pulp_scale = 0.42,
    .pulp_start = 0.2,
    .pdl_width = 220,
    .bone_width = 820,
    .bone_wave = 0.2,
    .bone_turn = 2.1,
    .density = { [GSN_PHANTOM_CONN] = 0.16,
                 [GSN_PHANTOM_DENT] = 0.60,
                 [GSN_PHANTOM_PULP] = 0.10,
                 [GSN_PHANTOM_PDL] = 0.38,
                 [GSN_PHANTOM_BONE] = 0.82,
                 [GSN_PHANTOM_MARR] = 0.05 },
    .lamella = 0.04,
    .lamella_length = 95,
    .slope_z = 0.06,
    .lesion = { -580, -384, 660 },
    .lesion_radius = { 480, 540, 300 },
    .lesion_turn = 1.1,
    .lesion_in_pdl = 0.5,
    .region_depth = 400,
    .region_half_height = 270,
    .region_radius = 850,
    .outline = { { 2, .002, 1.1, .000451 },
                 { 3, .004, 2.7, -.000913 },
                 { 4, .005, 5.2, .000622 },
                 { 5, .002, .9, .00097 },
                 { 7, .003, 4.4, -.000538 } },
    .marrow = { { { 75, 1227, 1348 }, { 89, 137, 190 } },
                { { -263, 1574, 514 }, { 118, 153, 170 } },
                { { -652, 1454, 1297 }, { 111, 74, 109 } },
                { { 891, -1716, 505 }, { 64, 75, 220 } },
                { { -1513, 759, 300 }, { 146, 125, 136 } },
                { { 776, -656, 381 }, { 93, 88, 172 } },
                { { -916, -1176, 1231 }, { 122, 143, 152 } },
                { { 1559, 982, 1310 }, { 109, 157, 98 } },
                { { 580, 680, 331 }, { 116, 80, 201 } },
                { { -1549, -741, 248 }, { 130, 138, 128 } },
                { { 518, 1216, 669 }, { 89, 92, 130 } },
                { { 950, 1880, 621 }, { 108, 113, 150 } },
                { { 1157, 371, 936 }, { 120, 104, 222 } },
                { { 1688, 310, 1083 }, { 117, 84, 229 } },
                { { 699, 1361, 96 }, { 116, 130, 204 } },
                { { 1483, 465, 687 }, { 85, 109, 185 } },
                { { -1160, -565, 1197 }, { 99, 128, 179 } },
                { { -290, 1841, 103 }, { 81, 66, 136 } },
                { { 1047, -457, 791 }, { 87, 129, 180 } },
                { { 1196, -105, 905 }, { 149, 148, 130 } },
                { { 930, 1194, 1273 }, { 133, 151, 144 } },
                { { -262, -908, 115 }, { 149, 102, 117 } },
                { { -819, 1532, 826 }, { 70, 141, 117 } },
                { { 945, -1092, 1231 }, { 95, 117, 128 } },
                { { 1294, -326, 1287 }, { 107, 66, 148 } },
                { { 967, -1092, 632 }, { 66, 65, 213 } },
                { { -1693, 174, 895 }, { 140, 63, 117 } },
                { { 1160, 270, 1386 }, { 65, 95, 110 } },
                { { -1192, -400, 93 }, { 142, 78, 186 } },
                { { -955, 1836, 1206 }, { 83, 118, 209 } },
                { { -142, 1145, 416 }, { 143, 135, 229 } },
                { { -388, 937, 441 }, { 98, 111, 181 } },
                { { 1569, 1395, 667 }, { 143, 122, 136 } },
                { { 1206, 824, 1052 }, { 122, 65, 119 } },
                { { -1619, -1224, 1356 }, { 83, 89, 163 } },
                { { -1261, -1337, 421 }, { 133, 78, 133 } },
                { { 101, -1187, 1319 }, { 113, 76, 126 } },
                { { -1363, 4, 1142 }, { 93, 133, 221 } },
                { { 1441, 1784, 849 }, { 128, 111, 139 } },
                { { -257, -1610, 1244 }, { 86, 132, 104 } } },
    .mark = { { 1350, -1500 }, { -1450, 1250 }, { -1000, -1700 } },
    .marrows = GSN_PHANTOM_MARROWS,
};

const struct gsn_phantom_geometry *gsn_phantom_geometry(void)
{
    return &GVP_D;
}

const struct gsn_phantom_geometry *gsn_phantom_geometry_find(const char *name)
{
    if (strcmp(name, "D") == 0)
        return &GVP_D;
    return strcmp(name, "P") == 0 ? &GVP_P : NULL;
}

double gsn_phantom_step(double t)
{
    const double u = fmin(fmax((t + 1) / 2, 0), 1);

    return u * u * (3 - 2 * u);
}

double gsn_phantom_section_z(const struct gsn_phantom_geometry *g, int k)
{
    return g->first_z + g->interval * k;
}

/* F, the smooth outline of the block. */
static double measure_tissue(const struct gsn_phantom_geometry *g, struct gsn_vec3 at)
{
    const double u = fabs(at.x) / g->ax, v = fabs(at.y) / g->ay;
    const double edge = g->delta / fmin(g->ax, g->ay);
    double phi, rho, waves = 0, bound = 0;

    for (int i = 0; i < GSN_PHANTOM_OUTLINE_WAVES; i++)
        bound += g->outline[i].a;
    /* max(u, v) <= rho (1 + waves) <= 2^(1/p) max(u, v): most points need no more than that. */
    if (fmax(u, v) >= (1 + edge) * (1 + bound))
        return 0;
    if (fmax(u, v) * exp2(1 / g->p) <= (1 - edge) * (1 - bound))
        return 1;

    rho = pow(pow(u, g->p) + pow(v, g->p), 1 / g->p);
    phi = atan2(at.y / g->ay, at.x / g->ax);
    for (int i = 0; i < GSN_PHANTOM_OUTLINE_WAVES; i++)
        waves +=
            g->outline[i].a * cos(g->outline[i].m * phi + g->outline[i].p + g->outline[i].w * at.z);
    return gsn_phantom_step((1 - rho / (1 + waves)) / edge);
}

/* Distance from the paraboloid of the root whose half axes are scaled and that starts later. */
static double measure_paraboloid(const struct gsn_phantom_geometry *g, struct gsn_vec3 at,
                                 double scale, double start)
{
    const double a = g->a * scale, b = g->b * scale;
    const double x = at.x - (g->cx + g->tx * at.z), y = at.y - (g->cy + g->ty * at.z);
    const double s = (at.z - g->apex_z) / g->root_length - start;
    const double value = (x / a) * (x / a) + (y / b) * (y / b) - s;
    const double gx = 2 * x / (a * a), gy = 2 * y / (b * b);
    const double gz = -1 / g->root_length - gx * g->tx - gy * g->ty;

    return value / sqrt(gx * gx + gy * gy + gz * gz);
}

double gsn_phantom_root_distance(const struct gsn_phantom_geometry *g, struct gsn_vec3 at)
{
    return measure_paraboloid(g, at, 1, 0);
}

static double bone_width(const struct gsn_phantom_geometry *g, struct gsn_vec3 at)
{
    const double theta = atan2(at.y - (g->cy + g->ty * at.z), at.x - (g->cx + g->tx * at.z));

    return g->bone_width * (1 + g->bone_wave * cos(theta - g->bone_turn));
}

/* How far the point is in the nearest marrow space, 0..1. */
static double measure_marrow(const struct gsn_phantom_geometry *g, struct gsn_vec3 at)
{
    /* No space is thinner than 4 delta: its soft edge ends within 1 + 1/4 radii. */
    const double far = 1.25;
    double most = 0;

    for (int i = 0; i < g->marrows; i++) {
        const struct gsn_vec3 c = g->marrow[i].centre, r = g->marrow[i].radius;
        const double x = at.x - c.x, y = at.y - c.y, z = at.z - c.z;
        double q;

        if (fabs(x) > far * r.x || fabs(y) > far * r.y || fabs(z) > far * r.z)
            continue;
        q = sqrt(x * x / (r.x * r.x) + y * y / (r.y * r.y) + z * z / (r.z * r.z));
        most = fmax(most, gsn_phantom_step((1 - q) * fmin(r.x, fmin(r.y, r.z)) / g->delta));
    }
    return most;
}

static void find_layers(const struct gsn_phantom_geometry *g, struct gsn_vec3 at, double d,
                        double layer[GSN_PHANTOM_LAYERS])
{
    const double root = gsn_phantom_step(-d / g->delta);
    const double beyond_pdl = gsn_phantom_step((d - g->pdl_width) / g->delta);
    double beyond_bone = 0, bone;

    for (int i = 0; i < GSN_PHANTOM_LAYERS; i++)
        layer[i] = 0;
    if (root > 0)
        layer[GSN_PHANTOM_PULP] =
            gsn_phantom_step(-measure_paraboloid(g, at, g->pulp_scale, g->pulp_start) / g->delta) *
            root;
    layer[GSN_PHANTOM_DENT] = root - layer[GSN_PHANTOM_PULP];
    layer[GSN_PHANTOM_PDL] = (1 - root) * (1 - beyond_pdl);
    if (beyond_pdl > 0)
        beyond_bone = gsn_phantom_step((d - g->pdl_width - bone_width(g, at)) / g->delta);
    layer[GSN_PHANTOM_CONN] = beyond_pdl * beyond_bone;
    bone = beyond_pdl * (1 - beyond_bone);
    if (bone > 0)
        layer[GSN_PHANTOM_MARR] = bone * measure_marrow(g, at);
    layer[GSN_PHANTOM_BONE] = bone - layer[GSN_PHANTOM_MARR];
}

/* E, a Gaussian turned about z. */
static double weigh_lesion(const struct gsn_phantom_geometry *g, struct gsn_vec3 at)
{
    const struct gsn_vec3 d = gsn_vec3_sub(at, g->lesion), r = g->lesion_radius;
    const double c = cos(g->lesion_turn), s = sin(g->lesion_turn);
    const double u = (c * d.x + s * d.y) / r.x, w = (c * d.y - s * d.x) / r.y, h = d.z / r.z;

    return exp(-(u * u + w * w + h * h) / 2);
}

void gsn_phantom_field_at(const struct gsn_phantom_geometry *g, struct gsn_vec3 at,
                          struct gsn_phantom_field *ret_field)
{
    struct gsn_phantom_field f = { .tissue = measure_tissue(g, at) };
    double d, bone, sum = 0;

    if (f.tissue > 0) {
        d = gsn_phantom_root_distance(g, at);
        find_layers(g, at, d, f.layer);
        f.lesion = weigh_lesion(g, at);
        bone = g->density[GSN_PHANTOM_BONE] * f.layer[GSN_PHANTOM_BONE] *
               (1 + g->lamella * cos(2 * M_PI * d / g->lamella_length)) *
               (1 - g->slope_z * at.z / g->height);
        for (int i = 0; i < GSN_PHANTOM_LAYERS; i++)
            if (i != GSN_PHANTOM_BONE)
                sum += g->density[i] * f.layer[i];
        f.bone = f.tissue * bone;
        f.intact = f.tissue * (sum + bone);
        f.lost = f.tissue * f.lesion *
                 (bone - g->floor * f.layer[GSN_PHANTOM_BONE] +
                  g->lesion_in_pdl * (g->density[GSN_PHANTOM_PDL] - g->floor) *
                      f.layer[GSN_PHANTOM_PDL]);
    }
    *ret_field = f;
}

void gsn_phantom_field_thicken(struct gsn_phantom_field *field, double gain)
{
    field->intact += (gain - 1) * field->bone;
    field->lost += (gain - 1) * field->lesion * field->bone;
    field->bone *= gain;
}

double gsn_phantom_density(const struct gsn_phantom_field *field, double depth)
{
    return field->intact - depth * field->lost;
}

int gsn_phantom_in_region(const struct gsn_phantom_geometry *g, struct gsn_vec3 at)
{
    const double x = at.x - g->lesion.x, y = at.y - g->lesion.y;
    double d;

    if (fabs(at.z - g->lesion.z) > g->region_half_height ||
        x * x + y * y > g->region_radius * g->region_radius)
        return 0;
    d = gsn_phantom_root_distance(g, at);
    return d >= g->pdl_width && d < g->pdl_width + g->region_depth;
}
