// gRPC's status as this library's.
#pragma once

#include <grpcpp/grpcpp.h>

#include "motiongen/core/status.hpp"

namespace motiongen {

// Code and message, and the reason of its ErrorInfo where the server has sent one (google/rpc/error_details.proto). Its
// details are read by hand: linking google.rpc's generated code twice would end the program at its start.
Status status_of(const grpc::Status& status);

}  // namespace motiongen
