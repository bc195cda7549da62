/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The front page of a store.
 *
 * Steps. 1. The records of every study (systemd/worker/study.h), which keep back what a blind study
 * hides, and of the specimens of none. 2. The page. 3. For each specimen with a report a link
 * "latest" beside the folders of its runs, put in place by a rename. To publish: the same records
 * again; the pages of the studies and each report that a record links to are copied where they
 * differ, and a page in the place of "latest" leads to the last report.
 *
 * Failure: the first file that cannot be written ends it, and is named. Cost: one report.json read
 * a specimen. */
#include "systemd/worker/store_index.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/study/index_page.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "systemd/worker/audit.h"
#include "systemd/worker/study.h"

enum { MOST_PAGE_BYTES = 1 << 28 };

/* All studies, and the specimens of none behind them. */
struct studies {
    size_t count;
    struct gsn_index_study *at;
    struct gsn_study_files **files; /* each owned */
    char **page;                    /* each owned */
};

static void studies_done(struct studies *studies)
{
    for (size_t i = 0; i < studies->count; i++) {
        gsn_study_files_free(studies->files[i]);
        gsn_free(studies->page[i]);
    }
    gsn_free(studies->at);
    gsn_free(studies->files);
    gsn_free(studies->page);
}
#define auto_studies __attribute__((cleanup(studies_done))) struct studies

static int no_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pages of a store");
}

static int add_study(struct gsn_store *store, const char *name, struct studies *studies,
                     struct gsn_error *err)
{
    const size_t i = studies->count;
    gsn_auto_mem(char) folder = NULL;
    gsn_auto_mem(char) page = NULL;
    int r = gsn_study_gather(store, name, &studies->files[i], err);

    if (r == GSN_E_NOTFOUND && !*name)
        return GSN_OK; /* every specimen is of a study */
    if (r < 0)
        return r;
    studies->count++;
    studies->at[i].input = gsn_study_files_input(studies->files[i]);
    if (!*name)
        return GSN_OK;
    r = gsn_store_study_dir(store, name, &folder, err);
    if (r < 0)
        return r;
    page = gsn_format("%s/index.html", folder);
    studies->page[i] = page ? gsn_study_link(page + strlen(gsn_store_dir(store)) + 1) : NULL;
    if (!page || !studies->page[i])
        return no_memory(err);
    /* `gieson study` and the night make it. */
    studies->at[i].page = access(page, F_OK) == 0 ? studies->page[i] : NULL;
    return GSN_OK;
}

static int gather_studies(struct gsn_store *store, struct studies *studies, struct gsn_error *err)
{
    gsn_auto(gsn_study_names) names = NULL;
    int r = gsn_study_list(store, &names, err);

    if (r < 0)
        return r;
    studies->at = gsn_alloc_array(names->count + 1, sizeof *studies->at);
    studies->files = gsn_alloc_array(names->count + 1, sizeof(struct gsn_study_files *));
    studies->page = gsn_alloc_array(names->count + 1, sizeof(char *));
    if (!studies->at || !studies->files || !studies->page)
        return no_memory(err);
    for (size_t i = 0; r >= 0 && i < names->count; i++)
        r = add_study(store, names->at[i], studies, err);
    return r < 0 ? r : add_study(store, "", studies, err);
}

/* ---- the store's own pages ----------------------------------------------------------------- */

static int write_page(struct gsn_store *store, const struct studies *studies, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/index.html", gsn_store_dir(store));
    gsn_auto_mem(char) bytes = NULL;
    size_t size;
    int r = path ? gsn_index_page(studies->at, studies->count, GSN_VERSION, &bytes, &size, err)
                 : no_memory(err);

    return r < 0 ? r : gsn_file_write(path, bytes, size, err);
}

/* reports/SPECIMEN/latest -> KEY */
int gsn_store_link_latest(struct gsn_store *store, const char *report_path, struct gsn_error *err)
{
    const char *const end = strrchr(report_path, '/');
    const char *key = end;
    gsn_auto_mem(char) target = NULL;
    gsn_auto_mem(char) link = NULL;
    gsn_auto_mem(char) part = NULL;
    char was[64] = "";

    while (key && key > report_path && key[-1] != '/')
        key--;
    if (!key || key == report_path)
        return GSN_OK;
    target = gsn_format("%.*s", (int)(end - key), key);
    link = gsn_format("%s/%.*s" GSN_LATEST, gsn_store_dir(store), (int)(key - report_path),
                      report_path);
    part = link ? gsn_format("%s.part", link) : NULL;
    if (!target || !part)
        return no_memory(err);
    if (readlink(link, was, sizeof was - 1) > 0 && strcmp(was, target) == 0)
        return GSN_OK;
    (void)unlink(part);
    if (symlink(target, part) < 0 || rename(part, link) < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", link, strerror(errno));
    return GSN_OK;
}

static int link_all(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    int r = gsn_specimen_list(store, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        gsn_auto(gsn_run_rows) runs = NULL;
        const struct gsn_run_row *last = NULL;

        r = gsn_run_list(store, rows->at[i].id, &runs, err);
        for (size_t k = 0; r >= 0 && k < runs->count; k++)
            if (*runs->at[k].report_path)
                last = &runs->at[k];
        if (last)
            r = gsn_store_link_latest(store, last->report_path, err);
    }
    return r;
}

int gsn_store_index_write(struct gsn_store *store, struct gsn_error *err)
{
    auto_studies studies = { 0 };
    int r = gather_studies(store, &studies, err);

    if (r >= 0)
        r = write_page(store, &studies, err);
    return r < 0 ? r : link_all(store, err);
}

/* ---- a copy of them ------------------------------------------------------------------------ */

/* name: from the store's folder. A page that is not there has not been made yet. */
static int publish_file(struct gsn_store *store, const char *folder, const char *name,
                        struct gsn_error *err)
{
    gsn_auto_mem(char) from = gsn_format("%s/%s", gsn_store_dir(store), name);
    gsn_auto_mem(char) to = gsn_format("%s/%s", folder, name);
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(uint8_t) there = NULL;
    size_t size, size_there;
    char *end;
    int r;

    if (!from || !to)
        return no_memory(err);
    r = gsn_file_read(from, MOST_PAGE_BYTES, &bytes, &size, err);
    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r < 0)
        return r;
    if (gsn_file_read(to, MOST_PAGE_BYTES, &there, &size_there, NULL) >= 0 && size == size_there &&
        memcmp(bytes, there, size) == 0)
        return GSN_OK;
    end = strrchr(to, '/');
    *end = '\0';
    r = gsn_file_mkdir(to, err);
    *end = '/';
    return r < 0 ? r : gsn_file_write(to, bytes, size, err);
}

/* The links of the records are paths but for "%25". */
static char *path_of_link(const char *link)
{
    char *path = gsn_strdup(link);
    size_t used = 0;

    for (const char *at = link; path && *at; at++) {
        path[used++] = *at;
        at += strncmp(at, "%25", 3) == 0 ? 2 : 0;
    }
    if (path)
        path[used] = '\0';
    return path;
}

static int publish_beside(struct gsn_store *store, const char *folder, const char *link,
                          const char *const *names, size_t count, struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of_link(link);
    char *end = path ? strrchr(path, '/') : NULL;
    int r = GSN_OK;

    if (!path)
        return no_memory(err);
    if (end)
        *end = '\0';
    for (size_t i = 0; end && r >= 0 && i < count; i++) {
        gsn_auto_mem(char) name = gsn_format("%s/%s", path, names[i]);

        r = name ? publish_file(store, folder, name, err) : no_memory(err);
    }
    return r;
}

/* A web server or a share may not follow links: a page at the place of "latest" that leads on. */
static int publish_latest(const char *folder, const char *path, struct gsn_error *err)
{
    const char *const end = strrchr(path, '/');
    const char *key = end;
    gsn_auto_mem(char) target = NULL;
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) to = NULL;
    gsn_auto_mem(char) place = NULL;
    int r;

    while (key && key > path && key[-1] != '/')
        key--;
    if (!key || key == path)
        return GSN_OK;
    target = gsn_format("../%.*s/report.html", (int)(end - key), key);
    place = gsn_format("%s/%.*s" GSN_LATEST, folder, (int)(key - path), path);
    to = place ? gsn_format("%s/report.html", place) : NULL;
    page = target ? gsn_format("<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">"
                               "<title>The last report</title>"
                               "<meta http-equiv=\"refresh\" content=\"0; url=%s\"></head>"
                               "<body><p><a href=\"%s\">The last report</a></p></body></html>\n",
                               target, target)
                  : NULL;
    if (!to || !page)
        return no_memory(err);
    r = gsn_file_mkdir(place, err);
    return r < 0 ? r : gsn_file_write(to, page, strlen(page), err);
}

static int publish_report(struct gsn_store *store, const char *folder, const char *link,
                          const char *const *names, size_t count, struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of_link(link);
    const int r = publish_beside(store, folder, link, names, count, err);

    if (r < 0)
        return r;
    return path ? publish_latest(folder, path, err) : no_memory(err);
}

int gsn_store_publish(struct gsn_store *store, const char *folder, struct gsn_error *err)
{
    static const char *const report[] = { "report.html", "report.json", "report.pdf",
                                          "base-cells.csv", "sections.html" };
    static const char *const study[] = { "index.html", "study.json", "animals.csv",
                                         "loss-cells.csv" };
    auto_studies studies = { 0 };
    int r = gather_studies(store, &studies, err);

    for (size_t k = 0; r >= 0 && k < studies.count; k++) {
        const struct gsn_study_input *const input = studies.at[k].input;

        if (studies.at[k].page)
            r = publish_beside(store, folder, studies.at[k].page, study,
                               sizeof study / sizeof study[0], err);
        for (size_t i = 0; r >= 0 && i < input->specimen_count; i++)
            if (input->specimen[i].page)
                r = publish_report(store, folder, input->specimen[i].page, report,
                                   sizeof report / sizeof report[0], err);
    }
    return r < 0 ? r : publish_file(store, folder, "index.html", err);
}
