// A session that is opened anew from the frames held: what its opening contains, where not all of it fits.
#include "session_stage.hpp"

namespace motiongen {
namespace {

constexpr std::uint32_t kPatch = 4;

// An open session with a prompt of so many bytes, whose windows see more frames than fit into a message beside that.
struct Telling : Stage {
  explicit Telling(std::size_t prompt_bytes) : Stage(with_prompt(prompt_bytes)) {
    known.models[0].patch_frames = kPatch;
    known.models[0].default_history_frames = 60;
    open();
    hear_opened("");
    hold(80);
    static_cast<void>(sent());
  }

  static v1::OpenSession with_prompt(std::size_t bytes) {
    v1::OpenSession open;
    open.add_prompts()->set_text(std::string(bytes, 'x'));
    return open;
  }

  std::vector<v1::SessionEvent> said_anew() {
    lose();
    open();
    return sent(v1::SessionEvent::kOpen);
  }
};

TEST(Reopened, HistoryIsCutToWhatFitsBesideTheRestOfTheOpening) {
  for (const std::size_t prompt_bytes : {100U, 1500U, 3000U, 3201U, 3202U, 3203U, 3204U, 3400U}) {
    Telling stage(prompt_bytes);
    const std::lock_guard<std::mutex> lock(stage.state.mutex);
    const auto said = stage.said_anew();
    ASSERT_EQ(said.size(), 1U) << prompt_bytes << ": " << stage.state.ended.message();
    EXPECT_EQ(said[0].open().prompts_size(), 1);
    EXPECT_LE(said[0].ByteSizeLong(), Outbox::most_event_bytes(stage.known.limits.max_request_bytes));
    const auto& rows = said[0].open().prior_frames();
    EXPECT_EQ(rows.frame_count() % kPatch, 0U);
    EXPECT_GE(rows.frame_count(), kPatch) << "or the character would jump to where it started";
    EXPECT_LE(rows.frame_count(), 60U);
    EXPECT_EQ(rows.data().size(), rows.frame_count() * stage.state.rig.own_width * sizeof(float));
  }
}

TEST(Reopened, SessionEndsWhereNotOnePatchOfHistoryFits) {
  Telling stage(3600);
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  EXPECT_TRUE(stage.said_anew().empty()) << "the server would end the stream";
  EXPECT_EQ(stage.state.phase, Phase::closed);
  EXPECT_EQ(stage.state.ended.code(), Code::invalid_argument);
}

TEST(Reopened, FramesOfTheFirstOpeningTakeNoRoom) {
  v1::OpenSession first;
  first.mutable_prior_frames()->set_data(std::string(3000, '\0'));
  Stage stage(std::move(first));
  stage.known.models[0].default_history_frames = 60;
  const std::lock_guard<std::mutex> lock(stage.state.mutex);
  stage.open();
  stage.hear_opened("");
  stage.hold(80);
  static_cast<void>(stage.sent());
  stage.lose();
  stage.open();
  const auto said = stage.sent(v1::SessionEvent::kOpen);
  ASSERT_EQ(said.size(), 1U);
  EXPECT_EQ(said[0].open().prior_frames().frame_count(), 60U);
}

}  // namespace
}  // namespace motiongen
