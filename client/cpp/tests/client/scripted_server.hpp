// A server in the test's own process, which sends what the test wants at moments that the test chooses.
#pragma once

#include <grpcpp/grpcpp.h>

#include <atomic>
#include <condition_variable>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <utility>

#include "motiongen/client/client.hpp"
#include "motiongen/v1/service.grpc.pb.h"

namespace motiongen {

// Sends its hello, answers pings, and passes every event to `hear`, which may write to the stream.
class ScriptedServer final : public v1::MotionService::Service {
 public:
  using Stream = grpc::ServerReaderWriter<v1::StreamMotionResponse, v1::StreamMotionRequest>;

  // Called on a stream's thread; set it before the first stream.
  std::function<void(const v1::SessionEvent& event, Stream& stream)> hear;
  // Write the parts of a clip, and add to the catalogue; set them before they are used.
  std::function<void(grpc::ServerWriter<v1::GenerateClipResponse>& parts)> make_clip;
  std::function<void(v1::GetCatalogResponse& catalog)> add_to_catalog;
  std::atomic<int> num_catalogs{0};
  std::atomic<int> num_pings{0};
  std::atomic<bool> is_frozen{false};  // accepts calls but sends nothing
  std::atomic<bool> says_hello{true};
  std::atomic<bool> answers_pings{true};

  ScriptedServer() {
    catalog_.add_rigs()->CopyFrom(rig());
    auto* model = catalog_.add_models();
    model->set_model_id("m");
    model->set_rig_id("r");
    catalog_.mutable_limits()->set_max_request_bytes(1 << 26);
    catalog_.mutable_limits()->set_max_lookahead_frames(80);
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port_);
    builder.SetMaxReceiveMessageSize(1 << 26);
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
  }

  ~ScriptedServer() override {
    end();
    server_->Shutdown();
  }

  static v1::Rig rig() {
    v1::Rig made;
    made.set_rig_id("r");
    made.add_joints("Hips");
    made.add_parents(-1);
    for (int axis = 0; axis < 3; ++axis) made.add_neutral_offsets_m(0);
    made.set_frame_rate(20);
    const std::pair<const char*, std::uint32_t> blocks[] = {
        {"root_translation_m", 3}, {"joint_rotation_quat_wxyz", 4}, {"foot_contact", 4}};
    for (const auto& [name, width] : blocks) {
      made.add_blocks()->set_name(name);
      made.mutable_blocks()->rbegin()->set_width(width);
    }
    return made;
  }

  // The answer to an event that opens a session.
  static v1::StreamMotionResponse opened(const v1::SessionEvent& open) {
    v1::StreamMotionResponse said;
    v1::SessionUpdate& update = *said.add_updates();
    update.set_session(open.session());
    update.mutable_opened()->set_rig_id("r");
    update.mutable_opened()->set_model_id("m");
    return said;
  }

  ClientOptions options() const {
    ClientOptions made;
    made.address = "127.0.0.1:" + std::to_string(port_);
    return made;
  }

  // End the present streams and all later ones.
  void end() {
    const std::lock_guard<std::mutex> lock(mutex_);
    ended_ = true;
    changed_.notify_all();
  }

  grpc::Status GetCatalog(grpc::ServerContext* /*context*/, const v1::GetCatalogRequest* /*request*/,
                          v1::GetCatalogResponse* response) override {
    ++num_catalogs;
    if (is_frozen) wait_for_end();
    *response = catalog_;
    if (add_to_catalog) add_to_catalog(*response);
    return grpc::Status::OK;
  }

  grpc::Status GenerateClip(grpc::ServerContext* /*context*/, const v1::GenerateClipRequest* /*request*/,
                            grpc::ServerWriter<v1::GenerateClipResponse>* parts) override {
    if (make_clip) make_clip(*parts);
    return grpc::Status::OK;
  }

  grpc::Status StreamMotion(grpc::ServerContext* context, Stream* stream) override {
    bool is_read = false;
    std::thread reader([this, stream, &is_read] {
      read(*stream);
      const std::lock_guard<std::mutex> lock(mutex_);
      is_read = true;
      changed_.notify_all();
    });
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this, &is_read] { return ended_ || is_read; });
    const bool has_finished = is_read;  // the client has half-closed the stream and waits for its end
    lock.unlock();
    if (!has_finished) context->TryCancel();  // otherwise the reader would wait for the client's next message
    reader.join();
    return has_finished ? grpc::Status::OK : grpc::Status::CANCELLED;
  }

 private:
  void wait_for_end() {
    std::unique_lock<std::mutex> lock(mutex_);
    changed_.wait(lock, [this] { return ended_; });
  }

  void read(Stream& stream) {
    v1::StreamMotionRequest request;
    while (stream.Read(&request)) {
      v1::StreamMotionResponse response;
      if (request.has_ping()) ++num_pings;
      if (request.has_hello() && says_hello) response.mutable_hello()->set_replica_id("scripted");
      if (request.has_ping() && answers_pings)
        response.mutable_pong()->set_client_time_ns(request.ping().client_time_ns());
      if (response.has_hello() || response.has_pong()) stream.Write(response);
      if (!hear) continue;
      for (const v1::SessionEvent& event : request.events()) hear(event, stream);
    }
  }

  v1::GetCatalogResponse catalog_;
  int port_ = 0;
  std::mutex mutex_;
  std::condition_variable changed_;
  bool ended_ = false;
  std::unique_ptr<grpc::Server> server_;
};

}  // namespace motiongen
