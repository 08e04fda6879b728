// A server that sends random messages in random order, drawn from fixed seeds: no number ends the application.
#include <cmath>
#include <iterator>
#include <random>

#include "client/convert.hpp"
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint64_t kNumbers[] = {0,
                                      1,
                                      2,
                                      3,
                                      5,
                                      8,
                                      40,
                                      1U << 16,
                                      0xFFFFFFFF,
                                      1ULL << 32,
                                      kLastFrame - 1,
                                      kLastFrame,
                                      kLastFrame + 1,
                                      1ULL << 63,
                                      ~0ULL - 1,
                                      ~0ULL};
constexpr std::uint32_t kNumInRange = 12;  // of these, as frames; a greater one ends the session
static_assert(kNumbers[kNumInRange - 1] == kLastFrame);

class Talk {
 public:
  explicit Talk(std::uint32_t seed) : random_(seed), stage_({}, options_of(seed)) { stage_.open(); }

  // One message of the server, or one action of the application.
  void go_on() {
    const std::lock_guard<std::mutex> lock(stage_.state.mutex);
    switch (below(12)) {
      case 0:
        return say_opened();
      case 1:
      case 2:
        return say_plan();
      case 3:
      case 4:
      case 5:
        return say_chunk();
      case 6:
        return say_outcome();
      case 7:
        return say_else();
      case 8:
        return lose();
      case 9:
        return edit();
      default:
        return look();
    }
  }

  std::uint64_t num_frames() const { return stage_.state.stats.frames; }
  bool is_over() const { return stage_.state.phase == Phase::closed; }

 private:
  static SessionOptions options_of(std::uint32_t seed) {
    SessionOptions options;
    options.clock = seed % 2 == 0 ? Clock::manual : Clock::real_time;
    options.frame_format = static_cast<FrameFormat>(1 + seed % 3);
    return options;
  }

  std::uint32_t below(std::uint32_t end) { return static_cast<std::uint32_t>(random_() % end); }
  std::uint64_t number() { return kNumbers[below(std::size(kNumbers))]; }
  std::uint64_t frame() { return below(60) == 0 ? number() : kNumbers[below(kNumInRange)]; }
  std::uint32_t small() { return static_cast<std::uint32_t>(number()); }
  // Mostly what a correct server would send.
  std::uint64_t near(std::uint64_t honest) { return below(60) == 0 ? number() : honest; }
  const Timeline* timeline() const { return stage_.state.timeline ? &*stage_.state.timeline : nullptr; }

  void say_opened() {
    if (stage_.state.phase == Phase::open && below(60) != 0) return;  // the session has not asked for it
    v1::SessionUpdate update;
    auto* opened = update.mutable_opened();
    opened->set_rig_id("r");
    opened->set_model_id("m");
    opened->set_start_frame(near(0));
    opened->set_lookahead_frames(static_cast<std::uint32_t>(near(8)));
    opened->set_session_token(below(2) == 0 ? "t" : "");
    place(opened->add_placements());
    stage_.hear(update);
    for (Event event; stage_.events.take(event);) {
      if (event.kind == EventKind::recovered && !event.exact) base_ = event.frame;
    }
  }

  void say_plan() {
    wire::Plan plan;
    plan.plan = timeline() != nullptr ? timeline()->plan() + 1 : 1;
    if (below(8) == 0) plan.plan = small();
    plan.valid_from = near(timeline() != nullptr ? timeline()->received_to() - base_ : 0);
    plan.is_cut = below(2) == 0;
    stage_.state.take_plan(plan, stage_.events, stage_.outbox);
  }

  void say_chunk() {
    if (timeline() != nullptr && timeline()->plan() == 0 && below(60) != 0) return say_plan();
    wire::Chunk chunk;
    const auto format = stage_.state.options.frame_format;
    const std::size_t row_bytes = timeline() != nullptr ? stored_row_bytes(stage_.state.rig, format) : 44;
    const std::string rows(row_bytes * (1 + below(8)), static_cast<char>(below(256)));
    const wire::Piece piece{reinterpret_cast<const std::uint8_t*>(rows.data()), rows.size()};
    chunk.data = wire::Cursor(&piece, rows.size());
    chunk.scalar_type = static_cast<std::uint64_t>(format);
    chunk.num_origin = below(16) == 0 ? 4 : 3;
    chunk.header.plan = static_cast<std::uint32_t>(near(timeline() != nullptr ? timeline()->plan() : 1));
    chunk.header.first_frame = near(timeline() != nullptr ? timeline()->received_to() - base_ : 0);
    chunk.header.num_frames = static_cast<std::uint32_t>(near(rows.size() / row_bytes));
    chunk.header.committed_to = near(timeline() != nullptr ? timeline()->committed_to() - base_ : 0);
    stage_.state.take_chunk(chunk, stage_.events, stage_.outbox);
  }

  void say_outcome() {
    v1::SessionUpdate update;
    auto* outcome = update.mutable_outcome();
    outcome->set_event_seq(1 + below(6));
    if (below(3) == 0) outcome->set_code(static_cast<int>(below(20)));
    if (below(2) == 0) outcome->set_effective_frame(frame());
    if (below(4) == 0) outcome->mutable_retry_after()->set_seconds(static_cast<std::int64_t>(number()));
    place(outcome->add_placements());
    stage_.hear(update);
    if (stage_.state.refusal) stage_.state.give_up_opening(stage_.events);
    stage_.state.refusal.reset();
  }

  void say_else() {
    v1::SessionUpdate update;
    update.set_applied_seq(number());
    switch (below(timeline() != nullptr ? 4 : 3)) {
      case 0:
        update.mutable_constraint_reached()->set_constraint_id(small());
        update.mutable_constraint_reached()->set_frame(frame());
        break;
      case 1:
        update.mutable_service_level()->set_tier(static_cast<v1::ServiceTier>(below(9)));
        update.mutable_service_level()->set_denoise_steps(small());
        break;
      case 2:
        update.mutable_durability()->set_is_kept(below(2) == 0);
        break;
      default:
        update.mutable_closed()->set_reason(v1::CLOSE_REASON_DRAINED);
    }
    stage_.hear(update);
  }

  void place(v1::ConstraintPlacement* placement) {
    placement->set_constraint_id(1 + below(4));
    placement->set_first_frame(frame());
    placement->set_last_frame(frame());
    placement->set_anchor_frame(frame());
    placement->set_anchor_x(below(4) == 0 ? HUGE_VALF : 1);
    placement->set_anchor_heading(below(4) == 0 ? NAN : 1);
  }

  // Lose the connection, then get another one with another catalogue.
  void lose() {
    stage_.lose();
    stage_.known.models[0].default_history_frames = small();
    stage_.known.models[0].patch_frames = small();
    stage_.known.models[0].horizon_frames = small();
    stage_.known.limits.max_events_per_second = static_cast<float>(stage_.known.models[0].horizon_frames);
    if (stage_.state.phase == Phase::waiting) stage_.open();
  }

  void edit() {
    if (is_over()) return;
    v1::SessionEvent event;
    if (below(3) == 0) {
      event.mutable_set_velocity()->set_hold_frames(small());
    } else if (below(2) == 0 && timeline() != nullptr) {
      event = stage_.state.seek_event(1 + number() / 2, stage_.known);
    } else {
      auto* target = event.mutable_edit_constraints()->add_upsert();
      target->set_constraint_id(1 + below(4));
      target->set_frame(below(100));
      target->set_frames_from_effect(below(2) == 0);
      target->set_relative_to_character(below(2) == 0);
      if (below(2) == 0) target->set_last_frame(below(200));
      for (int each = 0; each < 8; ++each) target->mutable_root_trajectory()->add_positions(1);
    }
    stage_.state.send_edit(std::move(event), stage_.outbox, stage_.events);
  }

  void look() {
    now_s_ += 0.1 * below(20);
    stage_.state.report(now_s_, 0.25, stage_.outbox);
    stage_.state.say_more(now_s_, stage_.outbox);
    static_cast<void>(stage_.sent());
    if (timeline() == nullptr) return;
    std::vector<float> row(stage_.state.rig.row_width);
    static_cast<void>(stage_.state.timeline->sample(now_s_, stage_.state.rig, row));
    if (stage_.state.options.clock == Clock::manual) static_cast<void>(stage_.state.advance_to(near(below(50))));
    const bool is_there = !timeline()->started() || timeline()->row(timeline()->playhead());
    EXPECT_TRUE(is_there) << "it would end the application";
  }

  std::mt19937 random_;
  Stage stage_;
  std::uint64_t base_ = 0;  // of the server's frames
  double now_s_ = 0;
};

TEST(RandomMessages, NoneOfThemEndsTheApplication) {
  int num_ended = 0;
  std::uint64_t num_frames = 0;
  for (std::uint32_t seed = 0; seed < 1000; ++seed) {
    Talk talk(seed);
    for (int time = 0; time < 400 && !talk.is_over(); ++time) talk.go_on();
    num_ended += talk.is_over() ? 1 : 0;
    num_frames += talk.num_frames();
  }
  EXPECT_GT(num_ended, 100) << "some must break a rule";
  EXPECT_GT(num_frames, 10000U) << "most must go on for a while";
}

}  // namespace
}  // namespace motiongen
