/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Spelling correction by the optimal string alignment distance: the table of R. A. Wagner and M. J.
 * Fischer, "The string-to-string correction problem", 1974, with the swap of neighbours of F. J.
 * Damerau, "A technique for computer detection and correction of spelling errors", 1964. Of equally
 * near words the first of the list is taken.
 *
 * Cost: the product of both lengths for each word of the list, three rows of the table at a time.
 */
#include "pipeline/core/nearest.h"

#include <ctype.h>
#include <string.h>

/* Longer words than this have no near one. */
enum { LONGEST = 40 };

static size_t smaller_of(size_t a, size_t b)
{
    return a < b ? a : b;
}

static int fold_letter(char c)
{
    return tolower((unsigned char)c);
}

/* Three rows of the table are enough. */
static size_t count_slips(const char *a, const char *b)
{
    const size_t n = strlen(a), m = strlen(b);
    size_t row[3][LONGEST + 1];

    for (size_t j = 0; j <= m; j++)
        row[0][j] = j;
    for (size_t i = 1; i <= n; i++) {
        size_t *now = row[i % 3];
        const size_t *last = row[(i + 2) % 3], *before = row[(i + 1) % 3];

        now[0] = i;
        for (size_t j = 1; j <= m; j++) {
            const int same = fold_letter(a[i - 1]) == fold_letter(b[j - 1]);

            now[j] = smaller_of(smaller_of(last[j], now[j - 1]) + 1, last[j - 1] + !same);
            if (i > 1 && j > 1 && fold_letter(a[i - 1]) == fold_letter(b[j - 2]) &&
                fold_letter(a[i - 2]) == fold_letter(b[j - 1]))
                now[j] = smaller_of(now[j], before[j - 2] + 1);
        }
    }
    return row[n % 3][m];
}

const char *gsn_nearest(const char *written, const char *const *words, size_t count)
{
    const size_t length = strlen(written), most = length / 3 < 2 ? 2 : length / 3;
    const char *best = NULL;
    size_t fewest = most + 1;

    if (length > LONGEST)
        return NULL;
    for (size_t i = 0; i < count; i++) {
        const size_t slips = strlen(words[i]) <= LONGEST ? count_slips(written, words[i]) : fewest;

        if (slips < fewest && slips < length) {
            fewest = slips;
            best = words[i];
        }
    }
    return best;
}
