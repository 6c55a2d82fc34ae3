"""Cells, ratios, and tables in both formats."""

from uncle.recon.evaluation.bench.tables import Table, cell, page, ratio


def test_cell_is_the_median_of_those_that_were_scored():
    records = [{"f": 0.9}, {"f": 0.5}, {"f": 0.6}, {}, {"f": None}]
    assert cell(records, "f", 100, 1, True) == "60.0 [50.0, 90.0]"
    assert cell(records, "f", 100, 1, False) == "60.0"
    assert cell(records[:1], "f", 100, 1, True) == "90.0"
    assert cell(records, "g", 100, 1, True) == "-"


def test_ratio_divides_medians_of_the_same_session():
    ours = [{"wall_s": s, "session": "a"} for s in (30.0, 40.0, 90.0)] + [{"wall_s": 1000.0, "session": "later"}]
    baseline = [{"wall_s": s, "session": "a"} for s in (10.0, 20.0, 99.0)] + [{"wall_s": 1.0, "session": "earlier"}]
    assert ratio(ours, baseline, "wall_s") == "2.00"
    assert ratio(ours[3:], baseline, "wall_s") == "-"


def test_both_formats_leave_empty_columns_out_and_have_the_notes():
    table = Table("A & B", ["name", "F", "ATE"], [["x|y", "1.0", "-"], ["<b>", "-", "-"]], 1, ["[1] lost\nits way"])
    assert table.markdown().splitlines() == [
        "## A & B",
        "",
        "| name | F |",
        "| --- | --- |",
        "| x\\|y | 1.0 |",
        "| <b> | - |",
        "",
        "- [1] lost its way",
    ]
    html = page("T", "lead", [table])
    assert "&lt;b&gt;" in html
    assert "<b>" not in html
    assert "ATE" not in html
    assert '<td class="number">1.0</td>' in html
    assert "[1] lost" in html
    assert "http" not in html  # nothing is loaded from anywhere
    assert Table("none", ["name"], []).markdown() == "## none"
