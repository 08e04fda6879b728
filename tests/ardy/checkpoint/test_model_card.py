"""Which folder a model's name stands for, and what its card says."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import pytest

from motiongen_ardy.checkpoint import model_card
from motiongen_ardy.checkpoint.hub import HubError
from motiongen_ardy.checkpoint.model_card import BUILT_IN_MODEL, UnknownModel, model_folder, read_model_card
from motiongen_ardy.checkpoint.released import NICKNAMES

Asked = list[tuple[str, str | None]]


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Asked:
    """The requests to the hub, which answers each with a folder that does not matter."""
    requests: Asked = []

    def answer(repository: str, revision: str | None = None) -> Path:
        requests.append((repository, revision))
        return Path("/from/the/hub")

    monkeypatch.setattr(model_card, "fetch_checkpoint", answer)
    monkeypatch.delenv("CHECKPOINTS_DIR", raising=False)
    return requests


def checkpoint(folder: Path) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.yaml").touch()
    return folder


def test_the_built_in_model_is_found_without_the_hub(asked: Asked) -> None:
    assert (model_folder(BUILT_IN_MODEL) / "config.yaml").is_file()
    assert asked == []


@pytest.mark.parametrize(
    ("name", "repository", "revision"),
    [
        ("core", "nvidia/ARDY-Core-RP-20FPS-Horizon40", None),
        ("core8", "nvidia/ARDY-Core-RP-20FPS-Horizon8", None),
        ("g1", "nvidia/ARDY-G1-RP-25FPS-Horizon52", None),
        ("g18", "nvidia/ARDY-G1-RP-25FPS-Horizon8", None),
        ("ARDY-G1-RP-25FPS-Horizon8", "nvidia/ARDY-G1-RP-25FPS-Horizon8", None),
        ("core@v1.2", "nvidia/ARDY-Core-RP-20FPS-Horizon40", "v1.2"),
        ("somebody/walker", "somebody/walker", None),
        ("somebody/walker@refs/pr/3", "somebody/walker", "refs/pr/3"),
    ],
)
def test_released_names_and_repositories_are_fetched_from_the_hub(
    asked: Asked, name: str, repository: str, revision: str | None
) -> None:
    model_folder(name)
    assert asked == [(repository, revision)]


def test_a_local_folder_takes_precedence_over_the_hub(
    asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checkpoint(tmp_path / "somebody" / "walker")
    monkeypatch.chdir(tmp_path)
    assert model_folder("somebody/walker") == Path("somebody/walker")
    assert asked == []


@pytest.mark.parametrize("name", ["core", "ARDY-Core-RP-20FPS-Horizon40", "my-own"])
def test_checkpoints_dir_takes_precedence_over_the_hub(
    asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setenv("CHECKPOINTS_DIR", str(tmp_path))
    folder = checkpoint(tmp_path / NICKNAMES.get(name, name))
    assert model_folder(name) == folder
    assert asked == []


def test_a_pinned_revision_ignores_checkpoints_dir(
    asked: Asked, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CHECKPOINTS_DIR", str(tmp_path))
    checkpoint(tmp_path / NICKNAMES["core"])
    model_folder("core@main")
    assert asked == [("nvidia/ARDY-Core-RP-20FPS-Horizon40", "main")]


@pytest.mark.parametrize(
    "name",
    [
        "",
        "cor",
        "a/b/c",
        "../x",
        "/no/such/folder",
        "core@",
        "core@a b",
        "core@-x",
        "x\0y",
        "somebody/..",
        "a@b",
        "~nobody-at-all/x",
    ],
)
def test_an_unknown_name_is_refused_with_the_known_ones(
    asked: Asked, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # elsewhere, "../x" might exist
    with pytest.raises(UnknownModel, match=r"motiongen-mini.*core, core40, core8, g1.*CHECKPOINTS_DIR"):
        model_folder(name)
    assert asked == []


def test_a_folder_without_a_config_is_refused(asked: Asked, tmp_path: Path) -> None:
    with pytest.raises(UnknownModel, match=r"holds no config\.yaml"):
        model_folder(str(tmp_path))


def test_an_error_of_the_hub_reaches_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(repository: str, revision: str | None = None) -> Path:
        raise HubError(f"{repository} is gated")

    monkeypatch.setattr(model_card, "fetch_checkpoint", refuse)
    monkeypatch.delenv("CHECKPOINTS_DIR", raising=False)
    with pytest.raises(HubError, match="gated"):
        model_folder("core")


def test_the_built_in_card_names_model_licence_and_attribution() -> None:
    card = read_model_card(model_folder(BUILT_IN_MODEL))
    assert (card.model_id, card.licence) == (BUILT_IN_MODEL, "CC-BY-NC-4.0")
    assert "Bandai Namco" in card.attribution


@pytest.mark.parametrize(
    "card",
    [
        "",
        "no front matter",
        "---\n- a list\n---\n",
        "---\n{unclosed: [\n---\n",
        "text\n---\nlicense: mit\n---\n",
        "---\nlicense: mit\nmade: !!timestamp yesterday\n---\n",
        "---\na: &a [x, x, x, x, x, x, x, x, x]\n"
        + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in pairwise("abcde"))
        + "license: *e\n---\n",
        "---\n",
    ],
)
def test_an_unusable_card_leaves_the_licence_unknown(tmp_path: Path, card: str) -> None:
    folder = checkpoint(tmp_path / "walker")
    (folder / "README.md").write_text(card)
    assert read_model_card(folder) == model_card.ModelCard("walker", "unknown", "")


def test_long_fields_of_a_card_are_truncated(tmp_path: Path) -> None:
    folder = checkpoint(tmp_path / "walker")
    (folder / "README.md").write_text(f"---\nname: {'x' * 9000}\nlicense: [mit, {'y' * 9000}]\n---\n")
    card = read_model_card(folder)
    assert (len(card.model_id), len(card.licence)) == (2000, 2000)
    assert card.licence.startswith("mit, y")


def test_license_name_of_a_hub_card_is_taken_as_the_licence(tmp_path: Path) -> None:
    folder = checkpoint(tmp_path / "walker")
    (folder / "README.md").write_text("---\nlicense: other\nlicense_name: nvidia-open-model-license\n---\n# Walker\n")
    assert read_model_card(folder).licence == "nvidia-open-model-license"


def test_an_overlong_name_is_refused_with_a_short_message() -> None:
    with pytest.raises(UnknownModel, match="a name of 5000 characters") as unknown:
        model_folder("x" * 5000)
    assert len(str(unknown.value)) < 200
