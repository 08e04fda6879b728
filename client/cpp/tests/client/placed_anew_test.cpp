// Targets of a session that is reopened more than once are where the newest session has placed them.
#include <gtest/gtest.h>

#include "client/book.hpp"
#include "client/convert.hpp"

namespace motiongen {
namespace {

constexpr std::size_t kMostPrompts = 16;

SessionBook opened_book() {
  SessionBook book(1, {});
  static_cast<void>(book.take_seq());
  book.opened({});
  return book;
}

Placement placement_of(std::uint32_t target, std::uint64_t first_frame, std::uint64_t last_frame) {
  Placement placement;
  placement.target = target;
  placement.first_frame = first_frame;
  placement.last_frame = last_frame;
  placement.anchor_frame = first_frame;
  return placement;
}

TEST(PlacedAnew, TargetHasThePlacementOfTheNewestSession) {
  SessionBook book = opened_book();
  Target there = Waypoint{0, 5, 5, {}, {}};
  there.at_any_frame = true;
  v1::SessionEvent event;
  *event.mutable_edit_constraints()->add_upsert() = convert::constraint(2, there);
  book.add(event);
  book.answer(2, Taken{10, {placement_of(2, 10, 120)}});
  ASSERT_EQ(book.reopening(60, 0, "", kMostPrompts).constraints_size(), 1);
  book.reopened(60, {placement_of(2, 60, 300)});
  book.forget_before(150);
  const v1::OpenSession again = book.reopening(200, 0, "", kMostPrompts);
  ASSERT_EQ(again.constraints_size(), 1) << "the target is still ahead";
  EXPECT_EQ(again.constraints(0).constraint_id(), 2U);
  EXPECT_EQ(book.reopening(301, 0, "", kMostPrompts).constraints_size(), 0);
}

TEST(PlacedAnew, PathContinuesAtTheCornerThatWasReached) {
  SessionBook book = opened_book();
  v1::SessionEvent event;
  *event.mutable_edit_constraints()->add_upsert() =
      convert::constraint(2, RootPath{{0, 1, 0, 2, 0, 3, 0, 4}, {}, {}, {}});
  book.add(event);
  book.answer(2, Taken{10, {placement_of(2, 0, 100)}});
  const auto left_at = [&book](std::uint64_t frame) {
    const v1::OpenSession open = book.reopening(frame, 0, "", kMostPrompts);
    return open.constraints_size() == 1 ? open.constraints(0).root_path() : v1::RootPath();
  };
  ASSERT_EQ(left_at(60).positions_size(), 4) << "two of four corners";
  Placement rest = placement_of(2, 60, 110);
  rest.anchor_z_m = 2;
  book.reopened(60, {rest});
  ASSERT_EQ(left_at(65).positions_size(), 4);
  EXPECT_EQ(left_at(65).positions(1), 3) << "no corner is repeated or skipped";
  ASSERT_EQ(left_at(105).positions_size(), 2);
  EXPECT_EQ(left_at(105).positions(1), 4);
}

}  // namespace
}  // namespace motiongen
