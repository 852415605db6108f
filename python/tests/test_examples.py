"""The examples run, and say what they should."""

import pathlib
import re
import runpy

EXAMPLES = pathlib.Path(__file__).parents[1] / "examples"


def test_own_simulator(capsys):
    runpy.run_path(str(EXAMPLES / "own_simulator.py"))
    printed = capsys.readouterr().out
    # The table of task 3, to the digits that were published: the loss after 1000 iterations under each model.
    published = {"direct_toi": "1.3958", "lcp": "1.4086", "direct": "2.0014", "convex": "2.0014"}
    for model, loss in published.items():
        assert re.search(rf"^{model} +wrong +{re.escape(loss)} ", printed, re.M), printed
    assert "wrong: mine: the gradient is wrong" in printed
    assert re.search(r"^  mended +right", printed, re.M), printed
