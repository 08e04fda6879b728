// Conversion of gRPC's status to this library's.
#pragma once

#include <grpcpp/grpcpp.h>

#include "motiongen/core/status.hpp"

namespace motiongen {

// Code and message, and the reason of an ErrorInfo if the server sent one (google/rpc/error_details.proto). The details
// are parsed by hand: if google.rpc's generated code were linked twice, the program would abort at its start.
Status status_of(const grpc::Status& status);

}  // namespace motiongen
