/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* gieson-decode after an attack that worked: it has entered the sandbox and now runs the attacker's
 * code. What that does is the file's first word. */
#include "pipeline/core/sandbox.h"
#include "pipeline/decode/apart_page.h"

#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

static struct gsn_decode_page *page;

static void opens(void)
{
    _exit(open("/etc/passwd", O_RDONLY | O_CLOEXEC) < 0 ? 7 : 0);
}

static void connects(void)
{
    _exit(socket(AF_UNIX, SOCK_STREAM, 0) < 0 ? 7 : 0);
}

static void forks(void)
{
    _exit(fork() < 0 ? 7 : 0);
}

static void starts(void)
{
    char *const argv[] = { (char *)(uintptr_t) "/bin/true", NULL };

    _exit(execv(argv[0], argv) < 0 ? 7 : 0);
}

static void crashes(void)
{
    abort();
}

static void hangs(void)
{
    for (volatile unsigned i = 0;; i++)
        ;
}

/* Asks for memory until there is none, and then gives up as a decoder does. */
static void eats(void)
{
    for (size_t i = 0; i < 4096; i++) {
        char *piece = malloc((size_t)1 << 24);

        if (!piece) {
            page->code = GSN_E_NOMEM;
            page->answered = 1;
            return;
        }
        memset(piece, 1, 4096);
    }
}

static void babbles(void)
{
    for (;;)
        if (write(1, "pay me", 6) < 0)
            _exit(0);
}

static void says_nothing(void)
{
}

/* A picture as a decoder would describe it; each lie spoils one thing of it. */
static void say_picture(void)
{
    page->answered = 1;
    page->code = GSN_OK;
    page->width = page->height = 8;
    page->channels = 3;
    page->bits = 8;
    page->pages = 1;
    memset(page->kind, 'k', sizeof page->kind);
    memset(page->note, '\n', sizeof page->note);
}

/* Answers, and is gone before the next question. */
static void leaves(void)
{
    say_picture();
    _exit(write(0, "", 1) < 0);
}

static void lies_about_size(void)
{
    say_picture();
    page->width = page->height = 0xffffffff;
}

static void lies_about_bits(void)
{
    say_picture();
    page->bits = 64;
}

static void lies_about_channels(void)
{
    say_picture();
    page->channels = 0;
}

static void lies_about_pitch(void)
{
    say_picture();
    memset(&page->px_um_x, 0xff, sizeof page->px_um_x);
}

static void lies_about_transfer(void)
{
    say_picture();
    page->transfer = 99;
}

static void lies_about_code(void)
{
    say_picture();
    page->code = GSN_E_STORE;
}

static void refuses_loudly(void)
{
    say_picture();
    page->code = GSN_E_INPUT;
    memset(page->text, '\33', sizeof page->text);
}

int main(void)
{
    static const struct {
        const char *word;
        void (*deed)(void);
    } deeds[] = {
        { "open", opens },
        { "connect", connects },
        { "fork", forks },
        { "start", starts },
        { "crash", crashes },
        { "hang", hangs },
        { "eat", eats },
        { "babble", babbles },
        { "leave", leaves },
        { "nothing", says_nothing },
        { "fair", say_picture },
        { "size", lies_about_size },
        { "bits", lies_about_bits },
        { "channels", lies_about_channels },
        { "pitch", lies_about_pitch },
        { "transfer", lies_about_transfer },
        { "code", lies_about_code },
        { "loud", refuses_loudly },
    };

    if (gsn_decode_page_map(gsn_decode_receive(0), &page, NULL) < 0 ||
        gsn_sandbox_enter(4, 1, NULL) < 0)
        return 3;
    for (;;) {
        const int fd = gsn_decode_receive(0);
        const char *word = fd >= 0 ? (const char *)gsn_decode_page_file(page, fd) : NULL;

        if (!word)
            _exit(0);
        for (size_t i = 0; i < sizeof deeds / sizeof deeds[0]; i++)
            if (strcmp(word, deeds[i].word) == 0)
                deeds[i].deed();
        (void)close(fd);
        if (write(0, "", 1) < 0)
            _exit(0);
    }
}
