/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-mesh: one question on stdin, one answer on stdout (pipeline/model/tetgen_wire.h).
 *
 * It enters the sandbox (pipeline/core/sandbox.h) before it reads the first byte.
 *
 * Exit status: 0 answered, a refusal included; 1 the question is damaged; 2 memory ran out before
 * an answer; 3 the answer could not be written; 4 there is no sandbox. Anything but 0 comes with
 * one line on stderr. */
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/sandbox.h"
#include "pipeline/model/tetgen_bridge.h"

enum { EXIT_ANSWERED, EXIT_QUESTION, EXIT_MEMORY, EXIT_ANSWER, EXIT_SANDBOX };
enum { ANSWER_FD = 3 };
enum { CHUNK = 1 << 16 };
static const size_t MOST_BYTES = (size_t)1 << 30;

/* TetGen talks on stdout. Keeps that for the answer and leaves TetGen to talk to nobody. */
static int take_stdout(void)
{
    return dup2(1, ANSWER_FD) < 0 || close(1) < 0 ? -1 : 0;
}

static int read_question(uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0, room = 0;

    for (;;) {
        ssize_t got;

        if (room - size < CHUNK) {
            uint8_t *larger;

            room = 2 * room + CHUNK;
            larger = gsn_realloc_array(bytes, room, 1);
            if (!larger)
                return gsn_fail(err, GSN_E_NOMEM, "out of memory for the question");
            bytes = larger;
        }
        got = read(0, bytes + size, room - size);
        if (got == 0)
            break;
        if (got < 0 && errno != EINTR)
            return gsn_fail(err, GSN_E_IO, "the question cannot be read: %s", strerror(errno));
        size += got > 0 ? (size_t)got : 0;
        if (size > MOST_BYTES)
            return gsn_fail(err, GSN_E_LIMIT, "the question is longer than %zu bytes", MOST_BYTES);
    }
    *ret_bytes = gsn_steal(&bytes);
    *ret_size = size;
    return GSN_OK;
}

static int write_answer(const uint8_t *bytes, size_t size)
{
    while (size > 0) {
        const ssize_t put = write(ANSWER_FD, bytes, size);

        if (put < 0 && errno != EINTR)
            return -1;
        bytes += put > 0 ? put : 0;
        size -= put > 0 ? (size_t)put : 0;
    }
    return 0;
}

/* Meshes and packs the answer; what cannot be meshed becomes a refusal. */
static int make_answer(const struct gsn_mesh_question *question, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    gsn_auto(gsn_soup) mesh = NULL;
    int r = question->surface ? gsn_surface_check(question->surface, &why) : GSN_OK;

    if (r >= 0)
        r = gsn_tetgen_mesh(question, &mesh, &why);
    if (r >= 0)
        return gsn_mesh_answer_pack(mesh, ret_bytes, ret_size, err);
    return gsn_mesh_refusal_pack(&why, ret_bytes, ret_size, err);
}

static int print_failure(const struct gsn_error *err, int status)
{
    (void)fprintf(stderr, "gieson-mesh: %s\n", err->text);
    return status;
}

static int answer_question(void)
{
    struct gsn_mesh_question question = { .surface = NULL };
    gsn_auto_mem(uint8_t) asked = NULL;
    gsn_auto_mem(uint8_t) said = NULL;
    struct gsn_error err = { 0 };
    size_t asked_size = 0, said_size = 0;
    int r;

    if (take_stdout() < 0) {
        (void)gsn_fail(&err, GSN_E_IO, "stdout: %s", strerror(errno));
        return print_failure(&err, EXIT_ANSWER);
    }
    if (gsn_sandbox_enter(ANSWER_FD, 0, &err) < 0)
        return print_failure(&err, EXIT_SANDBOX);
    r = read_question(&asked, &asked_size, &err);
    if (r >= 0)
        r = gsn_mesh_question_unpack(asked, asked_size, &question, &err);
    if (r < 0)
        return print_failure(&err, r == GSN_E_NOMEM ? EXIT_MEMORY : EXIT_QUESTION);
    r = make_answer(&question, &said, &said_size, &err);
    gsn_mesh_question_done(&question);
    if (r < 0)
        return print_failure(&err, EXIT_MEMORY);
    if (write_answer(said, said_size) < 0) {
        (void)gsn_fail(&err, GSN_E_IO, "the answer cannot be written: %s", strerror(errno));
        return print_failure(&err, EXIT_ANSWER);
    }
    return EXIT_ANSWERED;
}

int main(void)
{
    _exit(answer_question());
}
