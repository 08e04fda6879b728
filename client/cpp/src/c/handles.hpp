// What the opaque handles of the C interface point to.
#pragma once

#include <mutex>
#include <vector>

#include "motiongen/client/client.hpp"
#include "motiongen/motiongen.h"

struct motiongen_client {
  motiongen::Client client;
};

struct motiongen_clip {
  std::vector<motiongen::Clip> samples;
};

struct motiongen_session {
  motiongen::Session session;
};

struct motiongen_ground {
  motiongen::GroundFollower follower;
  std::mutex mutex;  // calls share the follower's working memory
};
