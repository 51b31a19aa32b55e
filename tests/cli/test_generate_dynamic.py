"""`twohands generate dynamic`: from the command line to files, and errors in one line."""

from twohands.cli.main import EXIT_USER_ERROR, main
from twohands.datasets.ego3dhands import Ego3DHands

SMALL = ["--sequences", "1", "--frames", "2", "--fps", "25", "--config.width", "64", "--config.height", "36"]


def test_writes_a_sequence_and_says_so(tmp_path, capsys):
    arguments = ["generate", "dynamic", "--out", str(tmp_path / "set"), "--seed", "2", *SMALL]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "procedural rooms" in said and "2 instances written" in said
    assert Ego3DHands(tmp_path / "set").sequences == {"00000": (0, 1)}
    assert main(arguments) == 0
    assert "0 instances written" in capsys.readouterr().out


def test_users_mistakes_are_one_line(tmp_path, capsys):
    for wrong, said in (
        (["--sequences", "0"], "sequences"),
        (["--backgrounds", str(tmp_path / "nowhere")], "does not exist"),
        (["--motion.max-speed", "0"], "max_speed"),
        (["--motion.duration", "0.3", "inf"], "duration must be an ordered pair of positive, finite seconds"),
        (["--motion.pause", "0.3", "inf"], "pause must be an ordered pair of positive, finite seconds"),
    ):
        assert main(["generate", "dynamic", "--out", str(tmp_path / "set"), *wrong]) == EXIT_USER_ERROR
        assert said in capsys.readouterr().err
    assert not (tmp_path / "set").exists()
