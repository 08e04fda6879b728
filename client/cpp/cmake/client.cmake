# motiongen_client: the transport on gRPC's callback API. The contract's C++ is generated here, with the protoc of the
# protobuf that it is linked with: any other pair refuses to compile or to run.
find_package(Threads REQUIRED)
find_package(Protobuf REQUIRED)
find_package(gRPC CONFIG REQUIRED)

set(generated ${CMAKE_CURRENT_BINARY_DIR}/generated)
file(MAKE_DIRECTORY ${generated})
set(generated_sources)
foreach(name motion session service)
  set(proto ${MOTIONGEN_PROTO_DIR}/motiongen/v1/${name}.proto)
  set(made ${generated}/motiongen/v1/${name}.pb.cc ${generated}/motiongen/v1/${name}.pb.h)
  set(plugin)
  if(name STREQUAL service)
    list(APPEND made ${generated}/motiongen/v1/${name}.grpc.pb.cc ${generated}/motiongen/v1/${name}.grpc.pb.h)
    set(plugin --grpc_out=${generated} --plugin=protoc-gen-grpc=$<TARGET_FILE:gRPC::grpc_cpp_plugin>)
  endif()
  add_custom_command(OUTPUT ${made} DEPENDS ${proto}
    COMMAND protobuf::protoc --cpp_out=${generated} ${plugin} -I ${MOTIONGEN_PROTO_DIR} ${proto})
  list(APPEND generated_sources ${made})
endforeach()

add_custom_target(motiongen_generated DEPENDS ${generated_sources})

# Generated code is not ours to warn about.
add_library(motiongen_proto OBJECT ${generated_sources})
add_dependencies(motiongen_proto motiongen_generated)
target_include_directories(motiongen_proto SYSTEM PUBLIC ${generated})
target_link_libraries(motiongen_proto PUBLIC gRPC::grpc++ protobuf::libprotobuf)

add_library(motiongen_client
  src/client/address.cpp
  src/client/book.cpp
  src/client/book_prompts.cpp
  src/client/call.cpp
  src/client/call_metadata.cpp
  src/client/channels.cpp
  src/client/client.cpp
  src/client/client_options.cpp
  src/client/clip.cpp
  src/client/clip_sample.cpp
  src/client/connection.cpp
  src/client/moving.cpp
  src/client/convert.cpp
  src/client/convert_catalog.cpp
  src/client/convert_targets.cpp
  src/client/core.cpp
  src/client/events.cpp
  src/client/frame_shift.cpp
  src/client/outbox.cpp
  src/client/placing.cpp
  src/client/reached.cpp
  src/client/route.cpp
  src/client/session.cpp
  src/client/session_edits.cpp
  src/client/session_frames.cpp
  src/client/session_opening.cpp
  src/client/session_saying.cpp
  src/client/session_state.cpp
  src/client/session_waiting.cpp
  src/client/short_call.cpp
  src/client/status_details.cpp
  src/client/texts.cpp
  src/client/wire.cpp
  src/client/worker.cpp
  $<TARGET_OBJECTS:motiongen_proto>)
add_library(motiongen::client ALIAS motiongen_client)
target_include_directories(motiongen_client
  PUBLIC $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include> $<INSTALL_INTERFACE:${CMAKE_INSTALL_INCLUDEDIR}>
  PRIVATE src)
target_include_directories(motiongen_client SYSTEM PRIVATE ${generated})
target_link_libraries(motiongen_client PUBLIC motiongen_core
  PRIVATE $<BUILD_INTERFACE:motiongen_library_flags> gRPC::grpc++ protobuf::libprotobuf Threads::Threads)
target_precompile_headers(motiongen_client PRIVATE <grpcpp/grpcpp.h> <grpcpp/generic/generic_stub.h>)
set_target_properties(motiongen_client PROPERTIES VERSION ${PROJECT_VERSION} SOVERSION 0 EXPORT_NAME client)
# call functions of the application, which may throw; the precompiled headers are compiled without exceptions
set_source_files_properties(src/client/call_metadata.cpp src/client/events.cpp PROPERTIES COMPILE_OPTIONS -fexceptions
  SKIP_PRECOMPILE_HEADERS ON)
