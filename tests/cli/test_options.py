"""Options that Click does not know by itself."""

import click
import pytest
from click.testing import CliRunner
from uncle.cli.options import FrameRange, SensorsCommand, expand_sensors, sensors_option


@click.command(cls=SensorsCommand)
@click.argument("dataset")
@sensors_option("Sensors.")
@click.option("--frames", type=FrameRange())
@click.option("--flag", is_flag=True)
def with_path(dataset, sensors, frames, flag):
    click.echo(f"{dataset} {','.join(sensors)} {frames} {flag}")


@click.command(cls=SensorsCommand)
@sensors_option("Sensors.")
@click.option("--seed", type=int)
def without_path(sensors, seed):
    click.echo(f"{','.join(sensors)} {seed}")


@pytest.fixture
def invoke(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "sl").mkdir()  # a folder called like a sensor
    return lambda command, line: CliRunner().invoke(command, line.split())


@pytest.mark.parametrize(
    "line",
    [
        "data --sensors sl psmnet --flag",
        "--sensors sl psmnet --flag data",
        "--flag --sensors sl psmnet data",
        "--sensors sl --sensors psmnet --flag data",
        "--sensors=sl data --sensors psmnet --flag",
        "--flag --sensors sl psmnet -- data",
    ],
)
def test_values_of_sensors_may_stand_anywhere(invoke, line):
    assert invoke(with_path, line).output == "data sl,psmnet None True\n"


@pytest.mark.parametrize("path", ["./data", "some/where", "/no/such/folder"])
def test_a_path_is_never_a_sensor(invoke, path):
    assert invoke(with_path, f"--sensors left right {path}").output == f"{path} left,right None False\n"


def test_without_positionals_every_value_is_a_sensor(invoke):
    assert invoke(without_path, "--sensors data sl --seed 3").output == "data,sl 3\n"


@pytest.mark.parametrize("line", ["--sensors", "--sensors --seed 3"])
def test_sensors_needs_a_value(invoke, line):
    result = invoke(without_path, line)
    assert result.exit_code == 2
    assert "--sensors needs" in result.output


def test_stray_values_are_refused(invoke):
    assert invoke(without_path, "sl --sensors psmnet").exit_code == 2
    assert invoke(with_path, "data extra --sensors sl").exit_code == 2


def test_without_the_flag_nothing_changes():
    line = ["data", "--run", "x", "-q", "--", "--sensors", "a"]
    assert expand_sensors(line) == line


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("0:300", slice(0, 300)),
        ("::10", slice(None, None, 10)),
        (":5", slice(None, 5)),
        ("-20:", slice(-20, None)),
        ("1:9:2", slice(1, 9, 2)),
    ],
)
def test_frame_ranges(text, expected):
    assert FrameRange().convert(text, None, None) == expected


@pytest.mark.parametrize("text", ["7", "a:b", "1:2:3:4", "::0", "::-1", "", "1.5:3"])
def test_bad_frame_ranges_are_usage_errors(invoke, text):
    result = CliRunner().invoke(with_path, ["data", "--frames", text])
    assert result.exit_code == 2
    assert "start:stop:step" in result.output
