"""Metrics: their names, and that the numbers of step reports, streams and prompts arrive in them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

from prometheus_client import Metric, generate_latest
from prometheus_client.parser import text_string_to_metric_families

from motiongen_server.engine.types import CloseReason, Code, PlanCause, PlayState, Priority, ServiceTier
from motiongen_server.engine.types.report import EventLatency, StepReport
from motiongen_server.ops.metrics import Metrics

SET_BY_THE_APPLICATION = {
    "motiongen_build_info",
    "motiongen_clips",
    "motiongen_clip_seconds",
    "motiongen_prompt_encode_seconds",
    "motiongen_prompts",
    "motiongen_prompts_waiting",
    "motiongen_engine_heartbeat_age_seconds",
    "motiongen_engine_up",
    "motiongen_model_engines",
    "motiongen_engine_restarts",
    "motiongen_engine_resident_memory_bytes",
    "motiongen_admission_rejects",
    "motiongen_session_resumes",
    "motiongen_sessions_parked",
    "motiongen_gateway_lag_seconds",
    "motiongen_client_loop_seconds",
    "motiongen_streams_held_back",
    "motiongen_event_loop_tasks",
    "motiongen_free_share",
    "motiongen_other_servers",
    "motiongen_slow_reader_closes",
    "motiongen_frames_dropped",
    "motiongen_streams",
    "motiongen_outbound_queue_bytes",
    "motiongen_snapshots",
    "motiongen_snapshot_lag_seconds",
    "motiongen_snapshot_store_up",
}
OF_THE_PROCESS = "process_"


def full_report() -> StepReport:
    """A step in which everything happened."""
    return StepReport(
        rows=3,
        bucket=4,
        prepare_seconds=0.001,
        step_seconds=0.02,
        decode_seconds=0.003,
        queue_waits=[0.01, 0.02],
        slacks=[(Priority.NEAR, 0.7)],
        deadlines=[Priority.HERO, Priority.HERO],
        windows=[(Priority.NEAR, PlanCause.EDIT)],
        deadline_misses=[Priority.HERO],
        frames_sent=40,
        memory_splits=1,
        soft_resets=2,
        frames_held=8,
        load=0.7,
        tiers={Priority.CROWD: ServiceTier.HOLD},
        frames_superseded=7,
        windows_discarded=1,
        windows_restarted=2,
        steps_discarded=3,
        nan_rows=1,
        runner_faults=1,
        client_underruns=[(Priority.CROWD, 5)],
        event_latencies=[EventLatency(Priority.NEAR, "prompt", 0.12)],
        opens=[Code.OK, Code.RESOURCE_EXHAUSTED],
        closes=[CloseReason.CLIENT],
        sessions={(Priority.NEAR, PlayState.PLAYING): 6},
    )


def value_of(metrics: Metrics, name: str, **labels: str) -> float | None:
    """A sample of the engine "0" of the model "tiny"."""
    return metrics.registry.get_sample_value(name, {"model": "tiny", "engine": "0", **labels})


def families(metrics: Metrics) -> dict[str, Metric]:
    return {family.name: family for family in metrics.registry.collect()}


def touched(family: Metric) -> bool:
    values = [sample.value for sample in family.samples if not sample.name.endswith("_created")]
    return any(value > 0 for value in values)


def test_every_metric_has_the_prefix_and_a_description() -> None:
    for name, family in families(Metrics()).items():
        assert name.startswith(("motiongen_", OF_THE_PROCESS))
        assert family.documentation.endswith(".")


def test_full_report_sets_every_metric_that_the_application_does_not() -> None:
    metrics = Metrics()
    metrics.of_engine("tiny", "0").observe(full_report())
    untouched = {name for name, family in families(metrics).items() if not touched(family)}
    untouched = {name for name in untouched if not name.startswith(OF_THE_PROCESS)}
    assert untouched == SET_BY_THE_APPLICATION


def test_numbers_of_step_reports_arrive() -> None:
    metrics = Metrics()
    metrics.of_engine("tiny", "0").observe(full_report())
    metrics.of_engine("tiny", "0").observe(full_report())
    value = partial(value_of, metrics)
    assert value("motiongen_frames_sent_total") == 80
    assert value("motiongen_batch_rows_sum") == 6
    assert value("motiongen_step_seconds_count", **{"bucket": "4"}) == 2
    assert value("motiongen_windows_total", **{"class": "NEAR", "cause": "EDIT"}) == 2
    assert value("motiongen_client_underruns_total", **{"class": "CROWD"}) == 10
    assert value("motiongen_session_opens_total", **{"code": "RESOURCE_EXHAUSTED"}) == 2
    assert value("motiongen_event_first_frame_seconds_sum", **{"class": "NEAR", "kind": "prompt"}) == 0.24
    assert value("motiongen_sessions", **{"class": "NEAR", "state": "PLAYING"}) == 6


def test_counts_of_the_streams_arrive() -> None:
    metrics = Metrics()
    metrics.reject("OVERLOADED")
    metrics.give_up_on_reader()
    metrics.drop_frames(12)
    value = metrics.registry.get_sample_value
    assert value("motiongen_admission_rejects_total", {"reason": "OVERLOADED"}) == 1
    assert value("motiongen_slow_reader_closes_total") == 1
    assert value("motiongen_frames_dropped_total") == 12


@dataclass
class Service:
    """An edge with its own counts."""

    num_streams: int = 3
    num_parked: int = 0
    num_waiting_bytes: int = 0
    num_other_servers: int = 0
    gateway_lag_s: float = 0.0
    loop_taken_s: float = 12.5
    num_held_back: int = 7


def test_counts_of_the_edge_are_read_when_requested() -> None:
    metrics, service = Metrics(), Service(3, 4, 5, 6, 0.5)
    metrics.watch_service(service)
    names = ("streams", "sessions_parked", "outbound_queue_bytes", "other_servers", "gateway_lag_seconds")
    value = metrics.registry.get_sample_value
    assert [value(f"motiongen_{name}") for name in names] == [3, 4, 5, 6, 0.5]
    service.num_parked = 0
    assert value("motiongen_sessions_parked") == 0


def test_clips_and_resumes_are_counted_by_outcome_and_complete_clips_timed() -> None:
    metrics = Metrics()
    metrics.end_clip("OK", 2.0, 3)
    metrics.end_clip("CANCELLED", 100.0, 1)
    metrics.count_resume("resumed")
    value = metrics.registry.get_sample_value
    assert value("motiongen_clips_total", {"code": "OK"}) == 3
    assert value("motiongen_clips_total", {"code": "CANCELLED"}) == 1
    assert value("motiongen_clip_seconds_sum") == 2.0
    assert value("motiongen_session_resumes_total", {"how": "resumed"}) == 1


def test_event_loop_time_of_messages_arrives() -> None:
    metrics, service = Metrics(), Service()
    value = metrics.registry.get_sample_value
    assert value("motiongen_client_loop_seconds_total") == 0
    metrics.watch_service(service)
    assert value("motiongen_client_loop_seconds_total") == 12.5
    assert value("motiongen_streams_held_back_total") == 7


def test_prompts_are_counted_by_source() -> None:
    metrics = Metrics()
    for source in ("store", "encoder", "encoder", "TEXT_ENCODER_SLOW"):
        metrics.count_prompt(source)
    value = metrics.registry.get_sample_value
    assert value("motiongen_prompts_total", {"source": "encoder"}) == 2
    assert value("motiongen_prompts_total", {"source": "TEXT_ENCODER_SLOW"}) == 1


def test_tier_of_every_class_is_set_from_the_start_and_follows_reports() -> None:
    metrics = Metrics()
    metrics.of_engine("tiny", "0")
    value = partial(value_of, metrics)
    assert [value("motiongen_service_tier", **{"class": priority.name}) for priority in Priority] == [1] * len(Priority)
    metrics.of_engine("tiny", "0").observe(full_report())
    assert value("motiongen_service_tier", **{"class": "CROWD"}) == ServiceTier.HOLD.value


def test_resident_memory_of_the_process_is_reported() -> None:
    assert (Metrics().registry.get_sample_value("process_resident_memory_bytes") or 0) > 1 << 20


def test_step_without_rows_does_not_count_as_denoising_step() -> None:
    metrics = Metrics()
    metrics.of_engine("tiny", "0").observe(StepReport())
    assert value_of(metrics, "motiongen_batch_rows_count") == 0


def test_every_class_and_state_starts_at_0_and_falls_back_to_it() -> None:
    metrics = Metrics()
    metrics.of_engine("tiny", "0")
    value = partial(value_of, metrics)
    for priority in Priority:
        for state in PlayState:
            assert value("motiongen_sessions", **{"class": priority.name, "state": state.name}) == 0
    metrics.of_engine("tiny", "0").observe(full_report())
    metrics.of_engine("tiny", "0").observe(StepReport(sessions={}))
    assert value("motiongen_sessions", **{"class": "NEAR", "state": "PLAYING"}) == 0


def test_metrics_of_both_engines_of_a_reloading_model_are_combined() -> None:
    metrics = Metrics()
    old, new = (metrics.of_engine("tiny", "0").observer() for _ in range(2))
    playing = partial(value_of, metrics, "motiongen_sessions", **{"class": "NEAR", "state": "PLAYING"})
    tier = partial(value_of, metrics, "motiongen_service_tier", **{"class": "NEAR"})
    counts = {(Priority.NEAR, PlayState.PLAYING): 3}
    old(StepReport(sessions=counts, load=0.75, tiers={Priority.NEAR: ServiceTier.FEWER_STEPS}))
    new(StepReport(sessions={(Priority.NEAR, PlayState.PLAYING): 2}, load=0.5, tiers={Priority.NEAR: ServiceTier.FULL}))
    assert (playing(), metrics.load_of("tiny"), tier()) == (5, 0.75, 2)
    old(StepReport(sessions={}, load=0.0, tiers={Priority.NEAR: ServiceTier.FULL}))
    assert (playing(), metrics.load_of("tiny"), tier()) == (2, 0.5, 1)


def test_models_have_separate_metrics_and_a_forgotten_one_has_none() -> None:
    metrics = Metrics()
    metrics.of_engine("tiny", "0").observe(full_report())
    for _ in range(2):
        metrics.of_engine("large", "0").observe(full_report())
    value = metrics.registry.get_sample_value
    assert value("motiongen_frames_sent_total", {"model": "tiny", "engine": "0"}) == 40
    assert value("motiongen_frames_sent_total", {"model": "large", "engine": "0"}) == 80
    metrics.forget_model("tiny")
    assert value("motiongen_frames_sent_total", {"model": "tiny", "engine": "0"}) is None
    assert value("motiongen_frames_sent_total", {"model": "large", "engine": "0"}) == 80
    assert (metrics.load_of("large"), metrics.load_of("tiny")) == (0.7, 0.0)


def test_metrics_text_is_valid_for_prometheus() -> None:
    metrics = Metrics()
    for model_id in ("tiny", "large"):
        metrics.of_engine(model_id, "0").observe(full_report())
    text = generate_latest(metrics.registry).decode()
    names = [family.name for family in text_string_to_metric_families(text)]
    assert len(names) == len(set(names))
    assert 'motiongen_step_seconds_count{bucket="4",engine="0",model="large"} 1.0' in text
