/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder_parts.h"

#include "pipeline/core/file.h"

#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <time.h>

/* Cells along a picture's longer side: what neighbouring sections share is larger than such a
 * cell, and finer ones laid none of the stacks we have better. */
enum { TISSUE_CELLS = 250 };

double gsn_folder_cpu_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return 1e3 * (double)now.tv_sec + 1e-6 * (double)now.tv_nsec;
}

static int is_picture(const struct dirent *entry)
{
    static const char *const ends[] = { ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".pam" };
    const char *dot = strrchr(entry->d_name, '.');

    if (entry->d_name[0] == '.' || !dot)
        return 0;
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++)
        if (strcasecmp(dot, ends[i]) == 0)
            return 1;
    return 0;
}

int gsn_folder_list(const char *dir, struct gsn_folder_stack *stack, struct gsn_error *err)
{
    struct dirent **entries = NULL;
    const int found = scandir(dir, &entries, is_picture, versionsort);
    int lost = 0;

    if (found < 0)
        return gsn_fail(err, errno == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", dir,
                        strerror(errno));
    stack->section = found > 0 ? gsn_alloc_array((size_t)found, sizeof *stack->section) : NULL;
    for (int i = 0; i < found; i++) {
        if (stack->section) {
            stack->section[i].file = gsn_strdup(entries[i]->d_name);
            lost |= !stack->section[i].file;
            stack->count++;
        }
        free(entries[i]); /* door */
    }
    free(entries); /* door */
    if (found == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s: no pictures (.png, .tif, .jpg) in this folder", dir);
    return stack->section && !lost ? GSN_OK
                                   : gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
}

/* What of a picture is needed to lay it by its tissue. One that shows none has no such pose. */
static int look_at_tissue(struct gsn_section_folder *folder, size_t i,
                          const struct gsn_image *image, struct gsn_error *err)
{
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_error own = { 0 };
    int r;

    if (!folder->options->by_tissue)
        return GSN_OK;
    if (!(folder->cell > 0))
        folder->cell = fmax(1, fmax((double)image->width, (double)image->height) / TISSUE_CELLS);
    r = gsn_tissue_reduce(image, folder->cell, &density, &own);
    if (r >= 0)
        r = gsn_tissue_new(density, folder->cell * folder->px_um, &folder->work[i].tissue, &own);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", own.text) : GSN_OK;
}

int gsn_folder_open(const struct gsn_section_folder *folder, const char *dir, size_t i,
                    struct gsn_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", dir, folder->stack->section[i].file);
    gsn_auto_fd picture_fd = -1;
    int r;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture of %s", dir);
    r = gsn_file_open(path, &picture_fd, err);
    return r < 0 ? r
                 : gsn_decode_apart(folder->options->decoder, picture_fd, NULL, ret_picture, err);
}

int gsn_folder_search(struct gsn_section_folder *folder, const char *dir, size_t i,
                      struct gsn_error *err)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error own = { 0 };
    double began;
    int r = gsn_folder_open(folder, dir, i, &picture, &own);

    began = gsn_folder_cpu_ms();
    if (r >= 0)
        r = gsn_mark_spots_find(picture->image, folder->px_um, &folder->work[i].spots, &own);
    if (r >= 0)
        r = look_at_tissue(folder, i, picture->image, &own);
    folder->work[i].search_ms = gsn_folder_cpu_ms() - began;
    if (r == GSN_E_NOMEM || r == GSN_E_PROCESS)
        return gsn_fail(err, r, "%s: %s", section->file, own.text);
    if (r < 0)
        (void)snprintf(section->reason, sizeof section->reason, "%s", own.text);
    return GSN_OK;
}
