// Plays a trace of calls on a timeline, one call for each line of input, and prints the result of each:
//   new RATE WIDTH START KEEP | plan NUMBER VALID_FROM IS_CUT | chunk PLAN FIRST COUNT COMMITTED | advance NOW_S
//   cut FRAME | to FRAME | pause | resume | scale FACTOR | anew (a new session continues this one)
// KEEP -1 keeps all. The numbers of a row are plan * 1000 + frame. After each call: its answer ("-" a refusal), then
// playhead, buffered_to, first_kept, committed_to, underruns, late_plans, the sum of the first numbers held, the newest
// cut among the frames held and the next one, or 0, received_to and plan.
#include <cstdio>
#include <iostream>
#include <optional>
#include <sstream>
#include <string>
#include <vector>

#include "motiongen/core/timeline.hpp"

namespace {

using motiongen::FrameRange;
using motiongen::Timeline;
using motiongen::TimelineOptions;

std::string shown(const FrameRange& range) {
  return std::to_string(range.size() == 0 ? 0 : range.first) + "+" + std::to_string(range.size());
}

std::string call(const std::string& name, std::istream& in, std::optional<Timeline>& timeline) {
  if (name == "new") {
    TimelineOptions options;
    std::int64_t keep = 0;
    in >> options.frame_rate_hz >> options.row_width >> options.start_frame >> keep;
    options.keep_frames = keep < 0 ? TimelineOptions::kKeepAll : static_cast<std::uint32_t>(keep);
    auto made = Timeline::make(options);
    if (!made) return "-";
    timeline.emplace(std::move(made).value());
    return "ok";
  }
  if (!timeline) return "?";
  if (name == "plan") {
    std::uint32_t plan = 0;
    std::uint64_t valid_from = 0;
    bool is_cut = false;
    in >> plan >> valid_from >> is_cut;
    return timeline->announce_plan(plan, valid_from, is_cut) ? "ok" : "-";
  }
  if (name == "chunk") {
    motiongen::ChunkHeader header;
    in >> header.plan >> header.first_frame >> header.num_frames >> header.committed_to;
    std::vector<float> rows;
    for (std::uint64_t frame = header.first_frame; frame < header.first_frame + header.num_frames; ++frame) {
      rows.insert(rows.end(), timeline->row_width(), static_cast<float>(header.plan * 1000 + frame));
    }
    motiongen::RowSpan source(rows);
    return timeline->add_chunk(header, source) ? "ok" : "-";
  }
  if (name == "advance") {
    double now_s = 0;
    in >> now_s;
    return shown(timeline->advance(now_s));
  }
  if (name == "cut") {
    std::uint64_t frame = 0;
    in >> frame;
    return std::to_string(timeline->note_cut(frame));
  }
  if (name == "to") {
    std::uint64_t frame = 0;
    in >> frame;
    auto reached = timeline->advance_to(frame);
    return reached ? shown(*reached) : "-";
  }
  if (name == "scale") {
    double scale = 0;
    in >> scale;
    return timeline->set_time_scale(scale) ? "ok" : "-";
  }
  if (name == "anew") timeline->continue_with_new_plans();
  if (name == "pause") timeline->pause();
  if (name == "resume") timeline->resume();
  return "ok";
}

}  // namespace

int main() {
  std::optional<Timeline> timeline;
  for (std::string line; std::getline(std::cin, line);) {
    std::istringstream in(line);
    std::string name;
    in >> name;
    const std::string answer = call(name, in, timeline);
    if (!timeline) return 1;
    double sum = 0;
    for (std::uint64_t frame = timeline->first_kept(); frame < timeline->buffered_to(); ++frame) {
      sum += static_cast<double>(timeline->row(frame).value()[0]);
    }
    std::printf(
        "%s %llu %llu %llu %llu %u %u %.0f %llu %llu %u\n", answer.c_str(),
        static_cast<unsigned long long>(timeline->playhead()), static_cast<unsigned long long>(timeline->buffered_to()),
        static_cast<unsigned long long>(timeline->first_kept()),
        static_cast<unsigned long long>(timeline->committed_to()), timeline->underruns(), timeline->late_plans(), sum,
        static_cast<unsigned long long>(timeline->cut_before(timeline->buffered_to() + 1).value_or(0)),
        static_cast<unsigned long long>(timeline->received_to()), timeline->plan());
  }
  return 0;
}
