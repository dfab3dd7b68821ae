from __future__ import annotations

from pathlib import Path

import pytest
from hydra.errors import InstantiationException
from hydra.utils import instantiate
from omegaconf import OmegaConf

from uncal.errors import ConfigurationError, RecordingError
from uncal.settings.configuration import CONFIG_DIR, INTERRUPTED, exits_on_error, find_config_dir


def test_configuration_is_found_beside_or_inside_the_package(tmp_path: Path) -> None:
    package = tmp_path / "uncal"
    inside = package / "conf"
    inside.mkdir(parents=True)
    with pytest.raises(ConfigurationError, match="no configuration folder at"):
        find_config_dir(package)
    (inside / "simulate.yaml").write_text("")
    assert find_config_dir(package) == str(inside)
    beside = tmp_path / "conf"
    beside.mkdir()
    (beside / "simulate.yaml").write_text("")
    assert find_config_dir(package) == str(beside)


def test_configuration_of_this_checkout_has_the_simulation() -> None:
    assert (Path(CONFIG_DIR) / "simulation" / "street.yaml").is_file()
    assert Path(CONFIG_DIR).is_absolute()


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (RecordingError("no frames in data"), "no frames in data"),
        (KeyboardInterrupt(), INTERRUPTED),
    ],
)
def test_entry_points_end_with_a_message_or_a_code(error: BaseException, code: object) -> None:
    @exits_on_error
    def main() -> None:
        raise error

    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == code


def test_what_a_constructor_says_is_not_wrapped() -> None:
    @exits_on_error
    def main(target: str) -> None:
        instantiate({"_target_": target, "root": "no/such/folder"})

    with pytest.raises(SystemExit) as ended:
        main("uncal.recordings.kitti.KittiRaw")
    assert str(ended.value.code).startswith("The recordings folder no/such/folder does not exist")
    assert "\n  no/such/folder/" in str(ended.value.code)


def test_what_a_library_says_of_a_setting_becomes_a_sentence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    @exits_on_error
    def main() -> None:
        config = OmegaConf.create({"head": {"_target_": "torch.nn.Dropout", "p": 1.5}})
        instantiate(config.head)

    with pytest.raises(SystemExit, match=r"^head \(torch.nn.*Dropout\): dropout probability .*1.5"):
        main()
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises(InstantiationException):
        main()


def test_the_whole_traceback_can_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    @exits_on_error
    def main() -> None:
        raise RecordingError("no frames in data")

    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    with pytest.raises(RecordingError):
        main()


def test_other_errors_keep_their_traceback_and_results_pass() -> None:
    @exits_on_error
    def divide(a: int, b: int) -> float:
        return a / b

    assert divide(6, b=3) == 2.0
    with pytest.raises(ZeroDivisionError):
        divide(1, 0)
