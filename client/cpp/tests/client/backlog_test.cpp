// Edits while no server answers: they are kept until one does, up to a bound for all sessions together.
#include "client/backlog.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "client/core.hpp"
#include "scripted_server.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kThird = Backlog::kMostWaiting / 3 + 1;

v1::SessionEvent prompt_of(std::size_t bytes) {
  v1::SessionEvent event;
  event.mutable_edit_prompts()->add_upsert()->set_text(std::string(bytes, 'x'));
  return event;
}

TEST(Backlog, EventCountsUntilItIsAnsweredOrItsSessionEnds) {
  const auto backlog = std::make_shared<Backlog>();
  std::optional<SessionBook> first(std::in_place, 1, v1::OpenSession(), backlog);
  SessionBook second(2, {}, backlog);
  v1::SessionEvent event = prompt_of(kThird);
  for (SessionBook* book : {&*first, &*first, &second}) {
    EXPECT_FALSE(backlog->is_full());
    book->add(event);
  }
  EXPECT_TRUE(backlog->is_full());
  second.begin_stream();
  static_cast<void>(second.unanswered(0));
  EXPECT_TRUE(backlog->is_full()) << "it was sent again, but not answered";
  second.answer(1, std::nullopt);
  EXPECT_FALSE(backlog->is_full());
  second.add(event);
  first.reset();
  second.add(event);
  EXPECT_FALSE(backlog->is_full());
  second.add(event);
  EXPECT_TRUE(backlog->is_full());
  second.drop_unanswered();
  EXPECT_FALSE(backlog->is_full());
}

TEST(Backlog, EditsBeyondTheBoundAreRefusedWhileDisconnected) {
  std::optional<ScriptedServer> server(std::in_place);
  const auto core = std::make_shared<ClientCore>(server->options());
  ASSERT_TRUE(core->connect());
  const auto session = core->open({});
  const auto other = core->open({});
  ASSERT_TRUE(session && other) << session.status().message();
  server.reset();
  while (core->is_connected()) std::this_thread::yield();
  for (const auto& told : {session, other, session}) EXPECT_TRUE(core->edit(*told.value(), prompt_of(kThird)));
  const auto refused = core->edit(*other.value(), prompt_of(1));
  EXPECT_EQ(refused.status().code(), Code::resource_exhausted);
  EXPECT_EQ(refused.status().reason(), "OUTBOX_FULL");
  EXPECT_EQ(core->open({}).status().reason(), "OUTBOX_FULL");
  {
    const std::lock_guard<std::mutex> lock(session.value()->mutex);
    session.value()->end_as_wished(core->events());
  }
  EXPECT_TRUE(core->edit(*other.value(), prompt_of(1))) << "edits of a session that ended no longer count";
  core->shut_down();
}

}  // namespace
}  // namespace motiongen
