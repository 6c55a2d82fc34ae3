import numpy as np
import pytest
from uncle.recon.core.errors import DataError
from uncle.recon.core.text import parse_number, read_table, read_text, text_lines

THREE = [(1.5, -2.25, 3.0), (0.5, 4.0, 1e-3)]


def rows_of(path, *widths):
    return list(read_table(path, lambda found: set(found) <= set(widths), f"{widths} numbers").rows)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends(tmp_path, encoding, end):
    text = end.join(["# tür", "1.5 -2.25 3", "", "0.5 4 1e-3  # note", ""])
    (tmp_path / "t.txt").write_bytes(text.encode(encoding))
    assert rows_of(tmp_path / "t.txt", 3) == THREE
    assert [line.number for line in text_lines(tmp_path / "t.txt")] == [2, 4]


@pytest.mark.parametrize(
    "text",
    [
        "1.5,-2.25,3\n0.5,4,0.001",
        "1.5, -2.25, 3,\n0.5, 4, 0.001,",
        "1.5;-2.25;3\n0.5;4;0.001",
        "1,5;-2,25;3\n0,5;4;0,001",
        "1,5 -2,25 3\n0,5 4 0,001",
        "1,5\t-2,25\t3,0\n0,5\t4,0\t1,0e-3",
        "1,5, -2,25, 3,0\n0,5, 4,0, 0,001",
        "[[1.5 -2.25 3.]\n [.5 4. 1D-3]]",
        "x y z\n1.5 \u22122.25 3\n0.5 4 1.0d-03",
        "1.5\u00a0-2.25\u00a03\n0.5 4 +1.E-3",
    ],
)
def test_separators_and_number_formats(tmp_path, text):
    (tmp_path / "t.txt").write_text(text, encoding="utf-8")
    assert rows_of(tmp_path / "t.txt", 3) == THREE


def test_names_and_header(tmp_path):
    (tmp_path / "t.csv").write_text("name, X, q_w []\na.png,1,2\nb.png,3,4\n")
    table = read_table(tmp_path / "t.csv", lambda widths: set(widths) == {2}, "2 numbers")
    assert (table.names, table.rows, table.lines) == (("a.png", "b.png"), ((1, 2), (3, 4)), (2, 3))
    assert table.header == ("name", "x", "q_w")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n1 2\n", r"t\.txt, line 2: expected .* found 2 numbers: '1 2'"),
        ("1 2 3\n1 zwei 3\n", r"line 2: 'zwei' is no number"),
        ("1 2 3\n1 1_0 3\n", r"line 2: '1_0' is no number"),
        ("1,5,2,5,3,5\n", r"line 1: expected .*a comma may separate"),
        ("1.234,5 2 3\n", r"line 1"),
        ("# nothing\n\n", "holds no numbers"),
    ],
)
def test_what_is_no_table_is_named(tmp_path, text, message):
    (tmp_path / "t.txt").write_text(text)
    with pytest.raises(DataError, match=message):
        rows_of(tmp_path / "t.txt", 3)


def test_commas_that_fit_both_ways_are_refused(tmp_path):
    (tmp_path / "t.txt").write_text("1,5 2,5\n")
    assert rows_of(tmp_path / "t.txt", 2) == [(1.5, 2.5)]
    with pytest.raises(DataError, match="its commas may separate numbers or stand for decimal points"):
        rows_of(tmp_path / "t.txt", 2, 4)


def test_numbers_that_are_not_finite_are_kept(tmp_path):
    (tmp_path / "t.txt").write_text("nan -inf 1.#QNAN\n-nan(ind) 1.#INF -1.#IND\n**** Infinity NaN\n")
    values = np.array(rows_of(tmp_path / "t.txt", 3))
    assert np.isnan(values).tolist() == [[True, False, True], [True, False, True], [True, False, True]]
    assert values[:, 1].tolist() == [-np.inf, np.inf, np.inf]
    assert parse_number("1e5") == 1e5
    assert parse_number("0x10") is parse_number("1e") is parse_number("") is None


@pytest.mark.parametrize("data", [b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\1\0", bytes(range(32)) * 4])
def test_binary_files_are_no_text(tmp_path, data):
    (tmp_path / "t.txt").write_bytes(data)
    with pytest.raises(DataError, match=r"t\.txt"):
        read_text(tmp_path / "t.txt")
    with pytest.raises(DataError, match=r"gone\.txt"):
        read_text(tmp_path / "gone.txt")


def test_an_empty_first_word_is_no_name(tmp_path):
    (tmp_path / "t.txt").write_text('""\t0 0 31\n0 52 24\n0 0 1\n')
    with pytest.raises(DataError, match=r"t\.txt"):
        read_table(tmp_path / "t.txt", lambda widths: set(widths) == {3}, "3 numbers")
