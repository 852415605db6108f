// JSON lines between a program that asks and a simulator that answers: one object a line, answers in order. Messages
// are in docs/how-to/audit-a-simulator.md.
//
// A simulator is greeted with a scene or with the names of a hybrid system. Steps begin in a mode with lists of numbers
// in the order of these names. A scene has the one mode "discs", the positions and velocities of its discs as state and
// a force on each as control; simulators that cannot take names have rows of one disc instead. Whole motions, of scenes
// only, are in rows, and are composed of steps if a simulator does not have them.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>

#include "saltus/audit/black_box.h"
#include "saltus/audit/hybrid_audit.h"
#include "saltus/hybrid/rigid_bodies.h"

namespace saltus {

using ProtocolJson = nlohmann::ordered_json;

// The exception for an unexpected answer: its message has what was expected and what arrived.
struct ProtocolError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// The names of a system as JSON: {"modes": [{"name", "states"}], "controls", "parameters"}.
ProtocolJson NamesToJson(const HybridSystem& system);

// Return the object that greets the simulator. `scene` is null if the system is not made of one.
ProtocolJson HelloOf(const Scene& scene);
ProtocolJson HelloOf(const HybridSystem& system, const ProtocolJson& scene);
// Returns the scene for that greeting: what the state, the control and the parameters of a step do not say. A body that
// moves in another way than freely has a joint, with the names and numbers of its kind.
ProtocolJson SceneToJson(const RigidBodies2D& bodies);
// Reads its answer. Throws ProtocolError.
BlackBoxTraits ReadHello(const std::string& line);

// Return a question without its id. The traits are those of the simulator that is asked.
ProtocolJson RequestToJson(const Scene& scene, const BlackBoxRequest& request, const BlackBoxTraits& traits);
ProtocolJson StepToJson(const HybridSystem& system, const SchemeStep& step, bool jacobian);
// Returns an answer as an object. Throws ProtocolError if it is none, or of another id.
ProtocolJson ReadReply(const std::string& line, std::int64_t id);
// Returns the reason in a reply without an answer; empty if there is an answer.
std::string ErrorIn(const ProtocolJson& reply);
// Reads a reply. Throws ProtocolError.
BlackBoxAnswer ParseAnswer(const ProtocolJson& reply, const Scene& scene, const BlackBoxRequest& request,
                           const BlackBoxTraits& traits);

// Describes a question for messages: "simulate of 480 steps".
std::string Describe(const BlackBoxRequest& request);
// Returns the beginning of a text, in quotes and without unprintable characters: at most 80 characters.
std::string Excerpt(const std::string& text);

// Returns numbers in rows of `width`: [[a, b], [c, d]].
ProtocolJson RowsToJson(const std::vector<double>& numbers, std::size_t width);
// Returns rows of rows of a control, with `discs` controlled discs a step.
ProtocolJson ControlRowsToJson(const std::vector<double>& control, std::size_t discs);
// Returns the numbers of nested lists of that shape, all finite. `what` is for the message of ProtocolError.
std::vector<double> NumbersFrom(const ProtocolJson& json, const std::vector<std::size_t>& shape,
                                const std::string& what);
// Returns those under a key, which is expected.
std::vector<double> NumbersAt(const ProtocolJson& json, const char* key, const std::vector<std::size_t>& shape);

}  // namespace saltus
