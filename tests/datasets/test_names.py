import pytest
from uncle.datasets.names import match_names, numbers_of_names, sorted_names


@pytest.mark.parametrize(
    "names",
    [
        ["1", "2", "10"],
        ["frame9", "frame10", "frame100"],
        ["1.25", "1.5", "10.25"],
        ["1305031102.175304123", "1305031102.175304124", "1305031102.9"],
        ["frame.9", "frame.10"],
        ["cam1.1", "cam1.9", "cam1.10"],
        ["a2", "a10", "b1", "ü3"],
    ],
)
def test_numbers_in_names_are_ordered_as_people_count(names):
    assert sorted_names(reversed(names)) == names


@pytest.mark.parametrize(
    ("names", "numbers"),
    [
        (["0001", "0010"], [1, 10]),
        (["cam0_0001", "cam0_0002"], [1, 2]),
        (["1.5", "10.25"], [1.5, 10.25]),
        (["frame 7"], [7]),
        (["a", "b"], None),
        (["1", "01"], None),
        (["1", "2_3"], None),
        ([], None),
    ],
)
def test_the_number_of_a_name_is_what_tells_it_from_the_others(names, numbers):
    assert numbers_of_names(names) == numbers


def test_names_match_before_numbers():
    assert match_names(["1", "2"], {"1": "a", "2": "b"}) == {"1": "a", "2": "b"}
    assert match_names(["frame1", "frame2"], {"depth_0002": "b", "depth_0001": "a"}) == {"frame1": "a", "frame2": "b"}
    assert match_names(["9", "10"], {"09": "a", "10": "b", "11": "c"}) == {"9": "a", "10": "b"}
    assert match_names(["7_100", "8_200"], {"d7_100": "a", "d8_201": "b"}) == {"7_100": "a"}
    assert match_names(["x", "y"], {"1": "a", "2": "b"}) == {}
