#!/usr/bin/env python3
# SPDX-License-Identifier: AGPL-3.0-or-later
"""What coverage.py says of a loss, against cases with a known answer, and what its sets hold."""
import contextlib
import io
import itertools
import math
import sys

import coverage


def report(loss, low, high):
    return {"loss_percent": loss, "loss_reason": None,
            "loss_interval": None if high is None else {"lower": low, "upper": high}}


def main():
    # An interval of 10 +- 2 at 95 %: a truth of 12 lies 1.96 standard errors below the figure.
    found = coverage.judge(report(10.0, 8.0, 12.0), 12.0)
    assert found["state"] == "reported" and found["covered"] and found["width"] == 4.0
    assert math.isclose(found["errors"], -coverage.ENDS) and found["error"] == -2.0
    # The end that counts is the one on the side of the truth.
    found = coverage.judge(report(10.0, 9.0, 14.0), 8.0)
    assert not found["covered"] and math.isclose(found["errors"], 2 * coverage.ENDS)
    # No width: any error is far off, and none is none.
    assert coverage.judge(report(10.0, 10.0, 10.0), 11.0)["errors"] == -99
    assert coverage.judge(report(10.0, 10.0, 10.0), 10.0)["errors"] == 0
    # A bound from above is no figure, and may be wrong.
    assert coverage.judge(report(None, None, 30.0), 20.0)["state"] == "bounded"
    assert not coverage.judge(report(None, None, 30.0), 31.0)["covered"]
    said = {**report(None, None, None), "loss_reason": "so the loss is at most 41.5 % and may be less"}
    found = coverage.judge(said, 40.0)
    assert found["state"] == "bounded" and found["covered"] and found["upper"] == 41.5
    assert not coverage.judge(said, 42.0)["covered"]
    found = coverage.judge(report(None, None, None), 20.0)
    assert found["state"] == "withheld" and "covered" not in found

    sets = [coverage.set_of(n) for n in range(48)]
    for values in itertools.product((0, 2, 5, 10), ("L1", "L2"), ("PNG", "JPEG 85")):
        assert any((s.turn, s.level, s.file) == values for s in sets), values
    for turn in coverage.TURNS:
        assert len({s.geometry for s in sets if s.turn == turn}) >= 10, turn
        assert {s.stain for s in sets if s.turn == turn} == {"dark", "haematoxylin"}, turn
    assert 4 <= sum(not s.poor for s in sets) <= 8

    # Two of three covered; errors of +1, -1 and +3 points.
    rows = [{**coverage.set_of(n)._asdict(), "poor": True, "stated": "nothing", "specimen": "S02",
             **coverage.judge(report(40.0 + e, 38.0 + e, 42.0 + e), 40.0)}
            for n, e in enumerate((1.0, -1.0, 3.0))]
    with contextlib.redirect_stdout(io.StringIO()) as said:
        coverage.show_row("all", rows)
    assert said.getvalue().split() == ["all", "3", "66.7", "+0.98", "4.00", "+1.00", "2.00",
                                       "3/0/0"], said.getvalue()
    print("coverage.py says what is")
    return 0


sys.exit(main())
