#include "output/replay.h"

#include <glog/logging.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <nlohmann/json.hpp>

#include "base/number_text.h"

namespace saltus {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kPositionQuantum = 1e-7;  // of the drawing's size
constexpr double kOtherQuantum = 1e-6;     // of the largest velocity or force
constexpr double kAngleQuantum = 1e-5;     // rad
constexpr size_t kMostTouches = 20000;     // of a motion; more are not seen

std::string Base64(const std::vector<uint8_t>& bytes) {
  static constexpr char kDigits[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const auto byte = [&](size_t j) { return i + j < bytes.size() ? uint32_t{bytes[i + j]} : 0u; };
    const uint32_t word = byte(0) << 16 | byte(1) << 8 | byte(2);
    for (int shift = 18; shift >= 0; shift -= 6) text += kDigits[word >> shift & 63];
  }
  const size_t missing = (3 - bytes.size() % 3) % 3;
  text.replace(text.size() - missing, missing, missing, '=');
  return text;
}

std::string Base64(const std::vector<double>& numbers) {
  std::vector<uint8_t> bytes(numbers.size() * sizeof(double));
  if (!bytes.empty()) std::memcpy(bytes.data(), numbers.data(), bytes.size());
  return Base64(bytes);
}

// Appends an integer, near zero in few bytes: 0, -1, 1, -2, ... as 0, 1, 2, 3, ... with 7 bits in each byte.
void AppendInteger(int64_t value, std::vector<uint8_t>* bytes) {
  uint64_t code = value < 0 ? 2 * static_cast<uint64_t>(-(value + 1)) + 1 : 2 * static_cast<uint64_t>(value);
  for (; code > 127; code >>= 7) bytes->push_back(static_cast<uint8_t>(128 | (code & 127)));
  bytes->push_back(static_cast<uint8_t>(code));
}

// Packs numbers in rows of `columns`; column j has the quantum j modulo their number.
Json Pack(const std::vector<double>& numbers, size_t columns, const std::vector<double>& quanta) {
  std::vector<uint8_t> bytes;
  bytes.reserve(numbers.size());
  for (size_t column = 0; column < columns; ++column) {
    const double quantum = quanta[column % quanta.size()];
    int64_t value = 0, slope = 0;
    for (size_t i = column; i < numbers.size(); i += columns) {
      // A number that is not finite is drawn at the position before it.
      const double multiple = numbers[i] / quantum;
      const int64_t next = std::abs(multiple) < 4e15 ? std::llround(multiple) : value;
      AppendInteger(next - value - slope, &bytes);
      slope = next - value;
      value = next;
    }
  }
  return {{"quanta", quanta}, {"data", Base64(bytes)}};
}

const char* KindName(ReplayWall::Kind kind) {
  switch (kind) {
    case ReplayWall::Kind::kHalfPlane:
      return "half-plane";
    case ReplayWall::Kind::kSide:
      return "side";
    case ReplayWall::Kind::kCircle:
      return "circle";
    case ReplayWall::Kind::kTable:
      return "table";
  }
  return "";
}

// Returns the largest of |numbers[i]| over i = first, first + 1 modulo `period`; 1 if all are 0.
double Largest(const std::vector<double>& numbers, size_t first, size_t period) {
  double largest = 0;
  for (size_t i = 0; i < numbers.size(); ++i) {
    if (i % period < first || i % period > first + 1 || !std::isfinite(numbers[i])) continue;
    largest = std::max(largest, std::abs(numbers[i]));
  }
  return largest > 0 ? largest : 1;
}

// Returns the extent of the positions of all motions, m.
double SizeOf(const Replay& replay) {
  double size = 0;
  for (size_t j = 0; j < 2; ++j) {
    double low = HUGE_VAL, high = -HUGE_VAL;
    for (const ReplayMotion& motion : replay.motions) {
      for (size_t i = j; i < motion.states.size(); i += 4) {
        if (!std::isfinite(motion.states[i])) continue;
        low = std::min(low, motion.states[i]);
        high = std::max(high, motion.states[i]);
      }
    }
    if (high >= low) size = std::max(size, high - low);
  }
  for (const ReplayDisc& disc : replay.discs) size = std::max(size, disc.radius);
  return size > 0 ? size : 1;
}

double Rounded(double value) { return std::isfinite(value) ? RoundedTo(6, value) : 0; }

Json TouchesToJson(const ReplayMotion& motion) {
  Json list = Json::array();
  for (const ReplayTouch& touch : motion.touches) {
    if (list.size() == kMostTouches) break;
    list.push_back({touch.a,
                    touch.b,
                    touch.wall ? 1 : 0,
                    touch.begin,
                    touch.end,
                    Rounded(touch.impulse[0]),
                    Rounded(touch.impulse[1])});
  }
  return list;
}

Json MotionToJson(const ReplayMotion& motion, size_t discs, double size, double speed) {
  CHECK(!motion.times.empty());
  CHECK_EQ(motion.states.size(), motion.times.size() * discs * 4);
  CHECK(motion.angles.empty() || motion.angles.size() == motion.times.size() * discs);
  CHECK_EQ(motion.control.size(), motion.ends.size() * motion.pushed.size() * 2);
  CHECK(motion.torques.empty() || motion.torques.size() == motion.ends.size() * motion.pushed.size());
  const double position = kPositionQuantum * size, velocity = kOtherQuantum * speed;
  const double force = kOtherQuantum * Largest(motion.control, 0, 2);
  Json json = {{"label", motion.label},
               {"remark", motion.remark},
               {"shown", motion.shown},
               {"colour", motion.colour},
               {"dash", DashName(motion.dash)},
               {"arcs", motion.arcs},
               {"times", Base64(motion.times)},
               {"states", Pack(motion.states, 4 * discs, {position, position, velocity, velocity})},
               {"angles", motion.angles.empty() ? Json() : Pack(motion.angles, discs, {kAngleQuantum})},
               {"touches", TouchesToJson(motion)},
               {"pushed", motion.pushed},
               {"ends", Base64(motion.ends)},
               {"control", Pack(motion.control, 2 * motion.pushed.size(), {force})},
               {"torques",
                motion.torques.empty()
                    ? Json()
                    : Pack(motion.torques, motion.pushed.size(), {kOtherQuantum * Largest(motion.torques, 0, 1)})}};
  for (const ReplaySpread& spread : motion.spreads) {
    CHECK_EQ(spread.covariances.size(), spread.times.size() * discs * 3);
    json["spreads"].push_back(
        {{"label", spread.label}, {"times", Base64(spread.times)}, {"covariances", Base64(spread.covariances)}});
  }
  return json;
}

}  // namespace

Json ReplayToJson(const Replay& replay) {
  CHECK(!replay.discs.empty() && !replay.motions.empty());
  Json data = {{"discs", Json::array()},
               {"walls", Json::array()},
               {"outlines", Json::array()},
               {"targets", replay.targets},
               {"motions", Json::array()}};
  for (const ReplayDisc& disc : replay.discs) {
    data["discs"].push_back({{"name", disc.name},
                             {"radius", disc.radius},
                             {"fixed", disc.fixed},
                             {"bounds", {disc.max_component, disc.max_force, disc.max_torque}}});
  }
  for (const ReplayWall& wall : replay.walls) {
    data["walls"].push_back({{"name", wall.name},
                             {"kind", KindName(wall.kind)},
                             {"point", wall.point},
                             {"normal", wall.normal},
                             {"radius", wall.radius}});
  }
  for (const Outline& outline : replay.outlines) {
    data["outlines"].push_back(
        {{"name", outline.name}, {"solid", SolidName(outline.solid)}, {"points", outline.points}});
  }
  const double size = SizeOf(replay);
  double speed = 0;
  for (const ReplayMotion& motion : replay.motions) speed = std::max(speed, Largest(motion.states, 2, 4));
  for (const ReplayMotion& motion : replay.motions) {
    data["motions"].push_back(MotionToJson(motion, replay.discs.size(), size, speed));
  }
  return data;
}

}  // namespace saltus
