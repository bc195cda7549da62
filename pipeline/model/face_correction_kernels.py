#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""Writes the kernels of pipeline/model/face_correction.h as straight-line C.

usage: face_correction_kernels.py tables|kernels|orders > FILE

A face has three clouds; its knot l of cloud k is number k (top + 1) + l. The sets are
T_g = {t_k,0..g_k} for 1 <= |g| <= top and everything that removing knots leads to. A set that has
lost a whole cloud is 0 where the point is clear of that cloud, so there are five classes of kernel:
face (no cloud may be lost), edge 0, 1, 2 (that one may) and vertex (any may). Planes, leaves and
weights are numbered with those of the face class first, so that a face that only has such points
prepares only those.
"""
import itertools
import sys

CLASSES = {"face": set(), "edge0": {0}, "edge1": {1}, "edge2": {2}, "vertex": {0, 1, 2}}
TOPS = (1, 2, 3)
# Degree of the spline, greatest |g|: with shared control points n - 1, else n.
CASES = ((1, 1), (2, 1), (2, 2), (3, 2), (3, 3))
KERNELS = [(degree, top, kind) for degree, top in CASES for kind in ("value", "slope")]
KERNELS += [(top, top, "weights") for top in TOPS]


def multi_indices(total):
    """(m,0,0), (m-1,1,0), (m-1,0,1), (m-2,2,0), ..."""
    return [(total - b - c, b, c)
            for rest in range(total + 1) for c in range(rest + 1) for b in (rest - c,)]


def gammas(top):
    return [g for m in range(1, top + 1) for g in multi_indices(m)]


def monomials(degree):
    """Exponents of x, y, z, by degree."""
    return [e for m in range(degree + 1) for e in multi_indices(m)]


class Face:
    """All knot sets of one top, numbered."""

    def __init__(self, top):
        self.top = top
        self.planes, self.leaves, self.nodes, self.weights = [], [], [], []
        self.counts = {}
        for name in CLASSES:
            self.enter(name)
            self.counts[name] = (len(self.planes), len(self.leaves), len(self.nodes),
                                 len(self.weights))

    def cloud(self, knot):
        return knot // (self.top + 1)

    def of_gamma(self, gamma):
        return tuple(k * (self.top + 1) + l for k in range(3) for l in range(gamma[k] + 1))

    def corners(self, gamma):
        return tuple(k * (self.top + 1) + gamma[k] for k in range(3))

    def alive(self, name, knots):
        return {0, 1, 2} - {self.cloud(k) for k in knots} <= CLASSES[name]

    def children(self, name, knots):
        """(member, rest) for every knot whose removal leaves something."""
        for i in range(len(knots)):
            rest = knots[:i] + knots[i + 1:]
            if self.alive(name, rest):
                yield i, rest

    def sets(self, name):
        """Every set of more than three knots that lives in a class, largest first."""
        layer = sorted({self.of_gamma(g) for g in gammas(self.top)}, key=lambda s: (-len(s), s))
        found = []
        while layer:
            size = len(layer[0])
            now = [s for s in layer if len(s) == size]
            later = [s for s in layer if len(s) < size]
            found += now
            if size > 4:
                later += [rest for s in now for _, rest in self.children(name, s)]
            layer = sorted(set(later), key=lambda s: (-len(s), s))
        return found

    def enter(self, name):
        for knots in self.sets(name):
            if len(knots) == 4 and knots not in self.leaves:
                self.leaves.append(knots)
                for triple in itertools.combinations(knots, 3):
                    if triple not in self.planes:
                        self.planes.append(triple)
            if len(knots) > 4:
                if knots not in self.nodes:
                    self.nodes.append(knots)
                for i, _ in self.children(name, knots):
                    if (knots, i) not in self.weights:
                        self.weights.append((knots, i))
        for gamma in gammas(self.top):
            if self.corners(gamma) not in self.planes:
                self.planes.append(self.corners(gamma))

    def leaf_planes(self, leaf):
        """The planes opposite the four knots."""
        return [self.planes.index(leaf[:i] + leaf[i + 1:]) for i in range(4)]


def array(kind, name, rows):
    """A static const table; rows of numbers or of rows."""
    text = []
    for row in rows:
        text.append("{ %s }" % ", ".join(map(str, row)) if isinstance(row, (list, tuple))
                    else str(row))
    inner = rows and isinstance(rows[0], (list, tuple)) and not kind.startswith("struct")
    width = "[%d]" % len(rows[0]) if inner else ""
    print("static const %s %s[%d]%s = {" % (kind, name, max(len(rows), 1), width))
    print(",\n".join("    " + t for t in text) if text else
          "    { 0 }" if kind.startswith("struct") else "    0")
    print("};\n")


def difference(face, a, b):
    """Places of the two vectors whose difference is knot a - knot b: knots come first, then their
    offsets from their vertices, which are more accurate inside one cloud."""
    shift = 3 * (face.top + 1) if face.cloud(a) == face.cloud(b) else 0
    return a + shift, b + shift


def row(face, knots, i):
    """Row i of the determinant of ascending knots."""
    near = face.cloud(knots[i]) == face.cloud(knots[i - 1])
    return difference(face, knots[i], knots[i - 1 if near else 0])


def write_tables():
    faces = {top: Face(top) for top in TOPS}
    print("/* Made by face_correction_kernels.py. */")
    for top, face in faces.items():
        name = "top%d_" % top
        for place, part in enumerate(("minuend1", "subtrahend1", "minuend2", "subtrahend2")):
            array("int", name + part,
                  [row(face, p, 1 + place // 2)[place % 2] for p in face.planes])
        array("uint8_t", name + "triple", face.planes)
        array("uint8_t", name + "leaf", face.leaves)
        array("uint16_t", name + "leaf_mask", [sum(1 << k for k in l) for l in face.leaves])
        array("uint8_t", name + "leaf_plane", [face.leaf_planes(l) for l in face.leaves])
        array("uint8_t", name + "leaf_row", [row(face, l, 3) for l in face.leaves])
        bases, ends = [], []
        for knots in face.nodes:
            bases += [i for i, l in enumerate(face.leaves) if set(l) <= set(knots)]
            ends.append(len(bases))
        array("uint16_t", name + "base", bases)
        array("uint16_t", name + "base_end", ends)
        array("struct gsn_face_correction_weight", name + "weight",
              [(face.nodes.index(knots), knots[i]) for knots, i in face.weights])
        parents, ends = [], []
        for child in face.leaves + face.nodes:
            parents += [w for w, (knots, i) in enumerate(face.weights)
                        if knots[:i] + knots[i + 1:] == child]
            ends.append(len(parents))
        array("uint16_t", name + "parent", parents)
        array("uint16_t", name + "parent_end", ends)
        array("uint8_t", name + "corners",
              [face.planes.index(face.corners(g)) for g in gammas(top)])
        sets = [face.of_gamma(g) for g in gammas(top)]
        array("uint8_t", name + "gamma",
              [sets.index(s) if s in sets else len(sets) for s in face.leaves + face.nodes])
    print("static const struct gsn_face_correction_tables gsn_face_correction_tables[%d] = {" % len(TOPS))
    for top, face in faces.items():
        name = "top%d_" % top
        print("    { .knots = %d," % (3 * (top + 1)))
        for field, index in (("planes", 0), ("leaves", 1), ("nodes", 2), ("weights", 3)):
            print("      .%s = { %d, %d }," %
                  (field, face.counts["face"][index], face.counts["vertex"][index]))
        print("      .minuend = { %sminuend1, %sminuend2 }," % (name, name))
        print("      .subtrahend = { %ssubtrahend1, %ssubtrahend2 }," % (name, name))
        for field in ("triple", "leaf", "leaf_mask", "leaf_plane", "leaf_row", "base", "base_end", "weight",
                      "parent", "parent_end", "gamma", "corners"):
            print("      .%s = %s%s," % (field, name, field))
        print("    },")
    print("};")


def betas(degree):
    """Multi-indices of four places in the order of gsn_simplex_place()."""
    return [(degree - sum(rest),) + rest for rest in monomials(degree)]


def write_orders():
    """Where the multi-indices of a tetrahedron go when its corners are taken in another order."""
    print("/* Made by face_correction_kernels.py. */")
    print("static const uint8_t turned[%d][24][20] = {" % len(TOPS))
    for degree in TOPS:
        places = {beta: i for i, beta in enumerate(betas(degree))}
        print("    {")
        for order in itertools.permutations(range(4)):
            row = []
            for beta in betas(degree):
                own = [0] * 4
                for place, corner in enumerate(order):
                    own[corner] = beta[place]
                row.append(places[tuple(own)])
            print("        { %s }," % ", ".join(map(str, row)))
        print("    },")
    print("};")


class Writer:
    """One kernel: names of what is computed, written where it is first needed."""

    def __init__(self, face, name, degree, kind):
        self.face, self.name, self.degree, self.kind = face, name, degree, kind
        self.lines, self.known, self.flops, self.count = [], {}, 0, 0

    def say(self, text, flops=0):
        self.lines.append("    " + text)
        self.flops += flops

    def fresh(self, value, flops):
        name = "t%d" % self.count
        self.count += 1
        self.say("const gsn_simd %s = %s;" % (name, value), flops)
        return name

    @staticmethod
    def fma(a, b, c):
        return "gsn_simd_fma(%s, %s, %s)" % (a, b, c)

    @staticmethod
    def all(place):
        return "gsn_simd_all(%s)" % place

    def affine(self, place):
        """place[0] x + place[1] y + place[2] z + place[3]."""
        value = self.all(place + "[3]")
        for i, axis in enumerate("xyz"):
            value = self.fma(self.all("%s[%d]" % (place, i)), axis, value)
        return self.fresh(value, 6)

    def plane(self, index):
        key = ("plane", index)
        if key not in self.known:
            value = self.count
            self.count += 1
            self.say("const gsn_simd t%d = PLANE(%d);" % (value, index), 6)
            self.say("least = gsn_simd_least(least, t%d);" % value)
            self.known[key] = "t%d" % value
        return self.known[key]

    def leaf(self, knots):
        index = self.face.leaves.index(knots)
        planes = [self.plane(p) for p in self.face.leaf_planes(knots)]
        return self.fresh("gsn_simd_where_signs_alternate(%s, data->leaf[%d])" %
                          (", ".join(planes), index), 0)

    def weight(self, knots, i):
        key = ("weight", knots, i)
        if key not in self.known:
            place = self.face.weights.index((knots, i))
            self.known[key] = self.affine("data->weight[%d]" % place)
        return self.known[key]

    def value(self, knots):
        """M(u | knots)."""
        key = ("value", knots)
        if key in self.known:
            return self.known[key]
        if len(knots) == 4:
            name = self.leaf(knots)
        else:
            text = None
            flops = -1
            for i, rest in self.face.children(self.name, knots):
                part, by = self.value(rest), self.weight(knots, i)
                text = "%s * %s" % (by, part) if text is None else self.fma(by, part, text)
                flops += 2
            name = self.fresh(text, flops) if text else None
        self.known[key] = name
        return name

    def slope(self, knots, axis):
        """The derivative of M along an axis, None where it is 0."""
        text, flops = None, -1
        if len(knots) == 4:
            return None
        for i, rest in self.face.children(self.name, knots):
            part = self.value(rest)
            place = self.all("data->weight[%d][%d]" % (self.face.weights.index((knots, i)), axis))
            text = "%s * %s" % (place, part) if text is None else self.fma(place, part, text)
            flops += 2
        if text and len(knots) > 5:
            text = "%s * (%s)" % (self.all("%d.0" % (len(knots) - 4)), text)
            flops += 1
        return self.fresh(text, flops) if text else None

    def power(self, exponents):
        factors = [axis for axis, times in zip("xyz", exponents) for _ in range(times)]
        return factors

    def polynomial(self, first, degree, terms=None):
        """Sum of coefficient times monomial, Horner-like: each monomial of degree two or more is
        its first variable times another polynomial."""
        if terms is None:
            terms = {e: ("data->poly[%d]" % (first + i), 1)
                     for i, e in enumerate(monomials(degree))}
        constant = terms.get((0, 0, 0))
        value = None
        flops = 0
        if constant:
            value = self.all(constant[0]) if constant[1] == 1 else self.all(
                "%d.0 * %s" % (constant[1], constant[0]))
        rest = {e: t for e, t in terms.items() if e != (0, 0, 0)}
        for axis in range(3):
            mine = {tuple(x - (i == axis) for i, x in enumerate(e)): t for e, t in rest.items()
                    if e[axis] > 0 and all(e[i] == 0 for i in range(axis))}
            if not mine:
                continue
            inner = self.polynomial(0, 0, mine)
            value = "%s * %s" % (inner, "xyz"[axis]) if value is None else self.fma(
                inner, "xyz"[axis], value)
            flops += 2
        if flops == 0:
            return value
        return self.fresh(value, flops)

    def derivative(self, first, degree, axis):
        terms = {}
        for i, e in enumerate(monomials(degree)):
            if e[axis] > 0:
                lower = tuple(x - (j == axis) for j, x in enumerate(e))
                terms[lower] = ("data->poly[%d]" % (first + i), e[axis])
        return self.polynomial(0, 0, terms) if terms else None

    def body(self):
        face, top = self.face, self.face.top
        first = 0
        sums = {}
        for place, gamma in enumerate(gammas(top)):
            knots = face.of_gamma(gamma)
            degree = self.degree - sum(gamma)
            value = self.value(knots) if face.alive(self.name, knots) else None
            size = len(monomials(degree)) if self.kind != "weights" else 0
            index = face.planes.index(face.corners(gamma))
            plane = self.plane(index)
            if value is None:
                sys.exit("a set of the face itself is never lost")
            if self.kind == "weights":
                self.say("gsn_simd_store(&ret[%d * GSN_SIMD_WIDTH], %s * %s);" % (place, plane, value),
                         1)
                continue
            poly = self.polynomial(first, degree)
            jump = self.fresh("%s * %s" % (poly, plane), 1)
            self.add(sums, "value", jump, value)
            if self.kind == "slope":
                for axis in range(3):
                    self.add_slope(sums, axis, first, degree, index, knots,
                                   {"poly": poly, "plane": plane, "jump": jump, "value": value})
            first += size
        return sums

    def add(self, sums, what, a, b):
        """sums[what] += a b."""
        if what not in sums:
            sums[what] = self.fresh("%s * %s" % (a, b), 1)
        else:
            sums[what] = self.fresh(self.fma(a, b, sums[what]), 2)

    def add_slope(self, sums, axis, first, degree, index, knots, names):
        """d(D v M) = (dD v + D dv) M + (D v) dM."""
        normal = self.all("data->plane[%d][%d]" % (index, axis))
        steep = self.derivative(first, degree, axis)
        turn = "%s * %s" % (names["poly"], normal)
        if steep:
            turn = self.fma(steep, names["plane"], turn)
        self.add(sums, axis, self.fresh(turn, 3 if steep else 1), names["value"])
        slope = self.slope(knots, axis)
        if slope:
            self.add(sums, axis, names["jump"], slope)

    def write(self):
        sums = self.body()
        print("KERNEL(%s)" % self.title())
        print("{")
        print("    BEGIN")
        print("\n".join(self.lines))
        if self.kind != "weights":
            print("    gsn_simd_store(ret, %s);" % sums["value"])
        if self.kind == "slope":
            print("    END_SLOPE(%s, %s, %s)" % (sums[0], sums[1], sums[2]))
        print("    END")
        print("}\n")

    def title(self):
        number = "%d" % self.face.top if self.kind == "weights" else "%d%d" % (
            self.degree, self.face.top)
        return "%s_%s_%s" % (self.kind, number, self.name)


def write_choice(flops):
    """The table of all kernels by kind, degree, top and unclear clouds (a bit each)."""
    classes = ("face", "edge0", "edge1", "vertex", "edge2", "vertex", "vertex", "vertex")
    print("#ifdef GSN_FACE_CORRECTION_CAREFUL")
    print("#define CHOICE(title, careful, flops) { NAME(careful), flops }")
    print("#else")
    print("#define CHOICE(title, careful, flops) { NAME(title), flops }")
    print("#endif")
    print("#define CHOICES \\")
    flops = dict(flops)
    for degree, top, kind in KERNELS:
        number = "%d" % top if kind == "weights" else "%d%d" % (degree, top)
        where = "[GSN_FACE_CORRECTION_%s][%d][%d]" % (kind.upper(), 0 if kind == "weights" else degree, top)
        rows = []
        for name in classes:
            title = "%s_%s_%s" % (kind, number, name if top > 1 else "vertex")
            rows.append("CHOICE(%s, %s_%s_vertex, %d)" % (title, kind, number, flops[title]))
        print("    %s = { %s }, \\" % (where, ", ".join(rows)))
    print()


def write_kernels():
    faces = {top: Face(top) for top in TOPS}
    print("/* Made by face_correction_kernels.py. */")
    flops = []
    for name in CLASSES:
        if name == "face":
            print("#ifndef GSN_FACE_CORRECTION_CAREFUL")
        if name == "vertex":
            print("#endif")
        for degree, top, kind in KERNELS:
            if top > 1 or name == "vertex":
                writer = Writer(faces[top], name, degree, kind)
                writer.write()
                flops.append((writer.title(), writer.flops))
    write_choice(flops)


if __name__ == "__main__":
    if sys.argv[1:] == ["tables"]:
        write_tables()
    elif sys.argv[1:] == ["kernels"]:
        write_kernels()
    elif sys.argv[1:] == ["orders"]:
        write_orders()
    else:
        sys.exit(__doc__)
