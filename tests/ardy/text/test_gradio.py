"""The client of ARDY's text service, against an app in this process that speaks its protocol."""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from motiongen_ardy.text import TextEncoderChanged, TextEncoderUnavailable, UnknownTextEncoder, load_text_encoder
from motiongen_ardy.text.gradio import GradioTextEncoder
from tests.ardy.text.fake_gradio import WIDTH, FakeGradio, serving, vector_of


@pytest.fixture
def app() -> Iterator[FakeGradio]:
    with serving(FakeGradio()) as app:
        yield app


def test_vectors_come_from_the_service_with_one_call_per_prompt(app: FakeGradio) -> None:
    encoder = GradioTextEncoder(app.url)
    prompts = ["a person walks", " \n", "él salta ✓"]
    vectors = encoder.encode(prompts)
    assert (encoder.width, vectors.dtype, vectors.shape) == (WIDTH, np.float32, (3, WIDTH))
    np.testing.assert_array_equal(vectors[[0, 2]], np.concatenate([vector_of(prompts[0]), vector_of(prompts[2])]))
    assert not vectors[1].any()
    assert app.texts == ["healthcheck", prompts[0], prompts[2]]  # nothing for the blank one
    assert all(name.endswith(".npy") and "/" not in name for name in app.file_names)
    assert len(set(app.file_names)) == 3


def test_the_result_may_be_a_file_without_a_button(app: FakeGradio) -> None:
    app.result = lambda path: [{"path": path, "meta": {"_type": "gradio.FileData"}}, "", ""]
    np.testing.assert_array_equal(GradioTextEncoder(app.url).encode(["hop"]), vector_of("hop"))


def test_the_identity_depends_on_the_vector_of_a_fixed_text(app: FakeGradio) -> None:
    first, second = GradioTextEncoder(app.url), GradioTextEncoder(app.url)
    app.encode = lambda text: vector_of(text) * 1.001
    other = GradioTextEncoder(app.url)
    assert first.identity == second.identity
    assert other.identity != first.identity
    assert first.identity.startswith("gradio-")


def test_after_a_failure_a_service_with_another_identity_is_refused(app: FakeGradio) -> None:
    encoder = GradioTextEncoder(app.url)
    app.fate = "down"
    with pytest.raises(TextEncoderUnavailable, match="HTTP status 502"):
        encoder.encode(["walk"])
    app.fate = ""
    np.testing.assert_array_equal(encoder.encode(["walk"]), vector_of("walk"))
    app.fate = "error"
    with pytest.raises(TextEncoderUnavailable, match="failed"):
        encoder.encode(["jump"])
    app.fate, app.encode = "", lambda text: vector_of(text + "!")
    for _ in range(2):
        with pytest.raises(TextEncoderChanged, match=encoder.identity):
            encoder.encode(["jump"])


def test_a_service_that_sends_only_heartbeats_times_out(app: FakeGradio, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = itertools.count()  # a second passes whenever the client looks at the time
    monkeypatch.setattr("motiongen_ardy.text.gradio.time", SimpleNamespace(monotonic=lambda: float(next(looks))))
    encoder = GradioTextEncoder(app.url, timeout_s=30.0)
    app.fate = "silent"
    with pytest.raises(TextEncoderUnavailable):
        encoder.encode(["walk"])
    assert next(looks) > 30


def pickled() -> bytes:
    file = io.BytesIO()
    np.save(file, np.array([{"a": 1}], dtype=object), allow_pickle=True)
    return file.getvalue()


def saved(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"<html>",
        pickled(),
        saved(np.zeros((2, WIDTH), np.float32)),
        saved(np.zeros((1, WIDTH + 1), np.float32)),
        saved(np.full((1, WIDTH), np.nan, np.float32)),
        saved(np.float32(3)),
    ],
)
def test_an_answer_that_is_not_a_vector_of_the_right_width_is_refused(app: FakeGradio, content: bytes) -> None:
    encoder = GradioTextEncoder(app.url)
    app.content = content
    with pytest.raises(TextEncoderChanged):
        encoder.encode(["walk"])


@pytest.mark.parametrize("result", [[], [None], ["x"], [{}], [{"value": {"path": 3}}], {"a": 1}, 7])
def test_malformed_results_are_refused(app: FakeGradio, result: Any) -> None:
    encoder = GradioTextEncoder(app.url)
    app.result = lambda path: result
    with pytest.raises(TextEncoderChanged, match="does not answer as ARDY's does"):
        encoder.encode(["walk"])


@pytest.mark.parametrize("path", ["file:///etc/passwd", "http://other.invalid/x", "../../x"])
def test_a_file_is_only_fetched_from_the_app_itself(app: FakeGradio, path: str) -> None:
    encoder = GradioTextEncoder(app.url)
    app.result = lambda _: [{"path": path}]
    with pytest.raises(TextEncoderUnavailable, match="404"):
        encoder.encode(["walk"])


@pytest.mark.parametrize("url", ["localhost:9550", "file:///etc/passwd", "ftp://x", "http://", "http://x/?a=1"])
def test_an_invalid_address_is_refused(url: str) -> None:
    with pytest.raises(UnknownTextEncoder, match="no address"):
        load_text_encoder(f"gradio:{url}")


def test_an_unreachable_service_is_reported_without_its_address(app: FakeGradio) -> None:
    with serving(FakeGradio()) as gone:
        pass
    with pytest.raises(TextEncoderUnavailable) as caught:
        load_text_encoder(f"gradio:{gone.url}", 4096)
    assert "127.0.0.1" not in str(caught.value)
