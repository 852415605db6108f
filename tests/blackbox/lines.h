// The lines of a scene's protocol, for simulators in this process.
#pragma once

#include <cstdint>
#include <string>

#include "blackbox/protocol.h"

namespace saltus {

inline std::string HelloLine(const Scene& scene) { return HelloOf(scene).dump(); }

inline std::string QuestionLine(const Scene& scene, const BlackBoxRequest& question, std::int64_t id,
                                const BlackBoxTraits& traits = {}) {
  ProtocolJson line = {{"id", id}};
  line.update(RequestToJson(scene, question, traits));
  return line.dump();
}

inline BlackBoxAnswer ReadAnswer(const std::string& line, const Scene& scene, const BlackBoxRequest& question,
                                 std::int64_t id, const BlackBoxTraits& traits) {
  return ParseAnswer(ReadReply(line, id), scene, question, traits);
}

}  // namespace saltus
