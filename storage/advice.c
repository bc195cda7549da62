/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The store's name in commands that people are to copy.
 *
 * A sentence is walked backquote by backquote; behind `gieson` goes --store DIR, quoted for a
 * shell, unless gieson opens that store by itself (GIESON_STORE, or the usual one). Apart from the
 * programs, because gieson and gieson-work both give advice. */
#include "storage/advice.h"

#include <stdlib.h>
#include <string.h>

#include "pipeline/core/mem.h"

const char *gsn_advice_usual_store(void)
{
    const char *said = getenv("GIESON_STORE");

    return said && said[0] ? said : "/var/lib/gieson";
}

char *gsn_advice(const char *store, const char *text)
{
    static const char ours[] = "gieson ";
    gsn_auto_mem(char) word = NULL;
    gsn_auto_mem(char) said = NULL;

    if (!store || !store[0] || strcmp(store, gsn_advice_usual_store()) == 0)
        return gsn_strdup(text);
    word = gsn_advice_word(store);
    if (!word)
        return NULL;
    for (const char *at = text; *at;) {
        const char *next = strstr(at, ours);
        const size_t length = next ? (size_t)(next - at) + strlen(ours) : strlen(at);
        const int is_command = next && (next == text || next[-1] == '`') && at[length] != '-';
        char *more =
            gsn_format("%s%.*s%s%s%s", said ? said : "", (int)length, at,
                       is_command ? "--store " : "", is_command ? word : "", is_command ? " " : "");

        gsn_free(said);
        said = more;
        if (!said)
            return NULL;
        at += length;
    }
    return said ? gsn_steal(&said) : gsn_strdup("");
}

char *gsn_advice_word(const char *text)
{
    static const char harmless[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
                                   "0123456789_-.,:+@%/";
    char *word;
    size_t used = 0;

    if (text[0] && !text[strspn(text, harmless)])
        return gsn_strdup(text);
    word = gsn_alloc_array(strlen(text) + 1, 4);
    if (!word)
        return NULL;
    word[used++] = '\'';
    for (; *text; text++) {
        if (*text == '\'') {
            memcpy(word + used, "'\\'", 3);
            used += 3;
        }
        word[used++] = *text;
    }
    word[used] = '\'';
    return word;
}
