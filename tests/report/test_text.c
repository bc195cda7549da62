/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/core/mem.h"
#include "pipeline/report/text.h"

#define CHECK_TEXT(text, truth)                                                                    \
    do {                                                                                           \
        CHECK(!(text).failed);                                                                     \
        assert_string_equal((text).bytes, truth);                                                  \
        CHECK((text).size == strlen(truth));                                                       \
        gsn_report_text_done(&(text));                                                             \
    } while (0)

static const char unknown[] = "\xEF\xBF\xBD";

TEST(base64_agrees_with_the_vectors_of_rfc_4648)
{
    static const char *const vector[][2] = { { "", "" },
                                             { "f", "Zg==" },
                                             { "fo", "Zm8=" },
                                             { "foo", "Zm9v" },
                                             { "foob", "Zm9vYg==" },
                                             { "fooba", "Zm9vYmE=" },
                                             { "foobar", "Zm9vYmFy" },
                                             { "\xFB\xEF\xBE\xFF", "++++/w==" } };

    for (size_t i = 0; i < sizeof vector / sizeof vector[0]; i++) {
        gsn_auto_report_text text = { .bytes = NULL };

        gsn_report_text_base64(&text, vector[i][0], strlen(vector[i][0]));
        CHECK_TEXT(text, vector[i][1]);
    }
}

TEST(markup_in_names_is_disarmed)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_escape(&text, "<script>alert(\"x\" & 'y')</script>");
    CHECK_TEXT(text, "&lt;script&gt;alert(&quot;x&quot; &amp; &#39;y&#39;)&lt;/script&gt;");
    gsn_report_text_escape(&text, "Zahnwurzel \xC3\xA4\xC3\xB6\xC3\xBC \xF0\x9F\xA6\xB7");
    CHECK_TEXT(text, "Zahnwurzel \xC3\xA4\xC3\xB6\xC3\xBC \xF0\x9F\xA6\xB7");
    gsn_report_text_escape(&text, NULL);
    gsn_report_text_raw(&text, "|");
    CHECK_TEXT(text, "|");
}

TEST(what_is_not_utf8_or_hides_becomes_the_replacement_character)
{
    /* A lone continuation, an overlong slash, a surrogate, beyond Unicode, a cut sequence; then a
     * bell, a delete and a right-to-left override. */
    static const struct {
        const char *said;
        size_t count;
    } bad[] = { { "\x80", 1 },         { "\xC0\xAF", 2 },
                { "\xED\xA0\x80", 3 }, { "\xF4\x90\x80\x80", 4 },
                { "\xE2\x82", 2 },     { "\a", 1 },
                { "\x7F", 1 },         { "\xE2\x80\xAE", 1 } };

    for (size_t i = 0; i < sizeof bad / sizeof bad[0]; i++) {
        gsn_auto_report_text text = { .bytes = NULL };

        gsn_report_text_escape(&text, bad[i].said);
        CHECK(text.size == 3 * bad[i].count);
        for (size_t k = 0; k < bad[i].count; k++)
            assert_memory_equal(text.bytes + 3 * k, unknown, 3);
    }
}

TEST(utf8_keeps_controls_and_mends_bytes)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_utf8(&text, "a\x01"
                                "b\xFF<");
    CHECK_TEXT(text, "a\x01"
                     "b\xEF\xBF\xBD<");
    gsn_report_text_utf8(&text, NULL);
    CHECK_TEXT(text, "");
}

TEST(long_names_are_cut_at_a_character)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_escape_short(&text, "\xC3\xA4\xC3\xB6\xC3\xBC<", 3);
    CHECK_TEXT(text, "\xC3\xA4\xC3\xB6\xC3\xBC\xE2\x80\xA6");
    gsn_report_text_escape_short(&text, "abc", 3);
    CHECK_TEXT(text, "abc");
}

TEST(numbers_are_written_for_people)
{
    static const struct {
        double value;
        int decimals;
        const char *truth;
    } plain[] = {
        { 36.585, 1, "36.6" },
        { -0.04, 1, "0.0" },
        { -2.25, 2,
          "\xE2\x88\x92"
          "2.25" },
        { 1204331, 0,
          "1\xE2\x80\xAF"
          "204\xE2\x80\xAF"
          "331" },
        { 8412, 0, "8412" },
        { 13822.5, 1,
          "13\xE2\x80\xAF"
          "822.5" },
        { (double)NAN, 1, "\xE2\x80\x93" },
        { (double)INFINITY, 1, "\xE2\x80\x93" },
    };
    gsn_auto_report_text text = { .bytes = NULL };

    for (size_t i = 0; i < sizeof plain / sizeof plain[0]; i++) {
        gsn_report_text_number(&text, plain[i].value, plain[i].decimals);
        CHECK_TEXT(text, plain[i].truth);
    }
    gsn_report_text_number(&text, 1e308, 0);
    CHECK(!text.failed && text.size > 309);
}

TEST(digits_are_significant_ones)
{
    static const struct {
        double value;
        int digits;
        const char *truth;
    } row[] = {
        { 0.87294, 4, "0.8729" },
        { 412.7, 4, "412.7" },
        { 123456, 3,
          "123\xE2\x80\xAF"
          "456" },
        { 0, 3, "0" },
        { 1.5e-6, 3, "1.5 \xC3\x97 10\xE2\x81\xBB\xE2\x81\xB6" },
        { -2e12, 3,
          "\xE2\x88\x92"
          "2 \xC3\x97 10\xC2\xB9\xC2\xB2" },
        { 1e-10, 1, "1 \xC3\x97 10\xE2\x81\xBB\xC2\xB9\xE2\x81\xB0" },
    };
    gsn_auto_report_text text = { .bytes = NULL };

    for (size_t i = 0; i < sizeof row / sizeof row[0]; i++) {
        gsn_report_text_digits(&text, row[i].value, row[i].digits);
        CHECK_TEXT(text, row[i].truth);
    }
    gsn_report_text_plain(&text, 0.05);
    CHECK_TEXT(text, "0.05");
    gsn_report_text_plain(&text, 120);
    CHECK_TEXT(text, "120");
    gsn_report_text_plain(&text, 1e-6);
    CHECK_TEXT(text, "1 \xC3\x97 10\xE2\x81\xBB\xE2\x81\xB6");
}

static int write_a_lot(struct gsn_error *err)
{
    gsn_auto_report_text text = { .bytes = NULL };

    for (int i = 0; i < 200; i++) {
        gsn_report_text_print(&text, "%d ", i);
        gsn_report_text_escape(&text, "<&>");
        gsn_report_text_base64(&text, "abc", 3);
    }
    return text.failed ? gsn_fail(err, GSN_E_NOMEM, "out of memory") : GSN_OK;
}

TEST(running_out_of_memory_is_remembered)
{
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(write_a_lot(&err), err);
}

TEST(a_field_of_a_table_is_quoted_and_no_formula)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_field(&text, "a \"b\", c");
    gsn_report_text_raw(&text, ",");
    gsn_report_text_field(&text, "=1+1");
    gsn_report_text_raw(&text, ",");
    gsn_report_text_field(&text, "\xFF");
    assert_string_equal(text.bytes, "\"a \"\"b\"\", c\",\"'=1+1\",\"\xEF\xBF\xBD\"");
}
