#include "client/events.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace motiongen {
namespace {

TEST(EventsDeathTest, CallbackThatThrowsEndsTheProgramWithItsMessage) {
  EventQueue events([](const Event&) { throw std::runtime_error("of the application"); });
  events.push(Event());
  const auto dispatch = [&events] {
    try {
      events.dispatch();
    } catch (const std::exception&) {  // as gRPC does on its threads
    }
  };
  EXPECT_DEATH(dispatch(), "of the application");
}

}  // namespace
}  // namespace motiongen
