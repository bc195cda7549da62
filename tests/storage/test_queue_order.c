/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/queue.h"

#include <stdbool.h>

#include "tests/check.h"

static int64_t next(const struct gsn_queue_node *nodes, size_t count)
{
    struct gsn_error err = { 0 };
    int64_t job = -1;

    CHECK_OK(gsn_queue_next_specimen_job(nodes, count, &job, &err), err);
    return job;
}

TEST(an_empty_queue_has_no_next)
{
    CHECK(next(NULL, 0) == 0);
}

TEST(a_baseline_goes_first_whatever_the_order_of_ids)
{
    const struct gsn_queue_node nodes[] = { { 1, 1, 10, 2, 0 }, { 2, 1, 20, 0, 0 } };

    CHECK(next(nodes, 2) == 20);
}

TEST(nobody_passes_a_baseline_that_is_not_ready)
{
    const struct gsn_queue_node nodes[] = { { 1, 1, 10, 2, 0 }, { 2, 1, 0, 0, 0 } };

    CHECK(next(nodes, 2) == 0);
}

TEST(a_circle_goes_by_the_lowest_id_and_one_at_a_time)
{
    struct gsn_queue_node nodes[] = { { 1, 1, 30, 2, 0 }, { 2, 1, 20, 3, 0 }, { 3, 1, 10, 1, 0 } };

    CHECK(next(nodes, 3) == 10);
    nodes[2].ready_job = 0; /* it runs */
    CHECK(next(nodes, 3) == 0);
}

TEST(those_who_wait_for_a_circle_wait_for_all_of_it)
{
    const struct gsn_queue_node nodes[] = { { 1, 1, 5, 2, 0 },
                                            { 2, 1, 20, 3, 0 },
                                            { 3, 1, 30, 2, 0 } };

    CHECK(next(nodes, 3) == 20);
}

enum { MOST = 9 };

static unsigned draw(unsigned *state, unsigned below)
{
    *state = *state * 1664525u + 1013904223u;
    return (*state >> 8) % below;
}

static bool waits(const struct gsn_queue_node *a, const struct gsn_queue_node *b)
{
    return a->specimen_id != b->specimen_id &&
           ((a->base_specimen && a->base_specimen == b->specimen_id) ||
            (a->base_group && a->base_group == b->group_id));
}

/* The rule again, by the closure of the relation (Warshall). */
static int64_t next_by_closure(const struct gsn_queue_node *nodes, size_t count)
{
    bool reach[MOST][MOST];
    int64_t best = 0;

    for (size_t i = 0; i < count; i++) {
        for (size_t j = 0; j < count; j++)
            reach[i][j] = waits(&nodes[i], &nodes[j]);
    }
    for (size_t k = 0; k < count; k++) {
        for (size_t i = 0; i < count; i++) {
            for (size_t j = 0; j < count; j++)
                reach[i][j] = reach[i][j] || (reach[i][k] && reach[k][j]);
        }
    }
    for (size_t i = 0; i < count; i++) {
        bool free_to_go = nodes[i].ready_job != 0;

        for (size_t j = 0; j < count; j++)
            free_to_go = free_to_go && (!reach[i][j] || (reach[j][i] && nodes[j].ready_job));
        if (free_to_go && (!best || nodes[i].ready_job < best))
            best = nodes[i].ready_job;
    }
    return best;
}

TEST(any_queue_follows_the_rule_and_drains)
{
    unsigned seed = 1;

    for (int round = 0; round < 3000; round++) {
        struct gsn_queue_node nodes[MOST];
        size_t count = 1 + draw(&seed, MOST);

        for (size_t i = 0; i < count; i++) {
            const bool by_group = draw(&seed, 3) == 0;

            nodes[i] = (struct gsn_queue_node){
                .specimen_id = (int64_t)i + 1,
                .group_id = 1 + draw(&seed, 3),
                .ready_job = 1 + (int64_t)((i * 7 + (size_t)round) % 10) * 10 + (int64_t)i,
                .base_specimen = by_group ? 0 : draw(&seed, (unsigned)count + 1),
                .base_group = by_group ? 1 + draw(&seed, 3) : 0,
            };
        }
        /* One that runs meanwhile, then the rest until nothing is left. */
        const size_t runs = draw(&seed, (unsigned)count);
        const int64_t its_job = nodes[runs].ready_job;

        nodes[runs].ready_job = 0;
        CHECK(next(nodes, count) == next_by_closure(nodes, count));
        nodes[runs].ready_job = its_job;
        while (count > 0) {
            const int64_t job = next(nodes, count);

            CHECK(job != 0);
            CHECK(job == next_by_closure(nodes, count));
            for (size_t i = 0; i < count; i++) {
                if (nodes[i].ready_job == job) {
                    nodes[i] = nodes[--count];
                    break;
                }
            }
        }
    }
}
