/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"
#include "pipeline/phantom/label.h"

enum { CELL = 48, LETTER = 6 * CELL };

/* Inked cells of one letter, counted at the centres of its 6 x 8 cells. */
static int ink(const char *text, int letter)
{
    int cells = 0;

    for (int row = 0; row < 8; row++)
        for (int column = 0; column < 6; column++)
            cells += gsn_phantom_label_has(text, letter * LETTER + (column + 0.5) * CELL,
                                           (row + 0.5) * CELL);
    return cells;
}

TEST(letters_stand_side_by_side_on_cells_of_48_um)
{
    CHECK(ink("-", 0) == 5);
    CHECK(gsn_phantom_label_has("-", 1, 3.5 * CELL));
    CHECK(!gsn_phantom_label_has("-", 5.5 * CELL, 3.5 * CELL));
    CHECK(!gsn_phantom_label_has("-", 1, 2.5 * CELL));
    CHECK(ink("S02", 1) == ink("0", 0));
    CHECK(ink("S02", 2) == ink("2", 0));
}

TEST(every_letter_of_the_names_has_a_shape_of_its_own)
{
    static const char names[] = "-012345DGPSV";

    for (size_t a = 0; names[a]; a++)
        for (size_t b = 0; b < a; b++) {
            const char one[] = { names[a], '\0' }, other[] = { names[b], '\0' };
            int differ = 0;

            for (int cell = 0; cell < 35; cell++) {
                const double x = (cell % 5 + 0.5) * CELL, y = (cell / 5 + 0.5) * CELL;

                differ += gsn_phantom_label_has(one, x, y) != gsn_phantom_label_has(other, x, y);
            }
            CHECK(differ >= 2);
        }
}

TEST(beyond_the_text_there_is_nothing)
{
    CHECK(ink("P01", 3) == 0);
    CHECK(!gsn_phantom_label_has("P", -1, 10));
    CHECK(!gsn_phantom_label_has("P", 10, -1));
    CHECK(!gsn_phantom_label_has("P", 10, 7 * CELL + 1));
    CHECK(ink("?", 0) == 0);
}
