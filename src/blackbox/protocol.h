// JSON lines between a program that asks and a simulator that answers: one object a line, answers in order.
//
//   -> {"saltus": 1, "scene": {...}, "names": {...}}  a scene file as JSON, with defaults filled in
//   -> {"saltus": 1, "hybrid": {...}, "scene": {...}} or a hybrid system; "scene" if it is made of one
//   <- {"name": "mine 1.0", "can": ["gradient"]}      optional: some of the abilities below; "not_applicable": "why";
//                                                     "grid_steps": n, if numbers of steps must be multiples of it
//
// "names" and "hybrid" have the names of states, controls and parameters:
//
//   {"modes": [{"name": "flight", "states": ["y", "v"]}], "controls": [...], "parameters": [...]}
//
// A step begins in a mode with lists of numbers in that order, and so does its answer:
//
//   -> {"id": 1, "step": {"mode": "flight", "t": 0, "h": 0.01, "state": [...], "control": [...], "parameters": [...],
//                         "jacobian": true}}          "jacobian" only if the simulator "can"
//   <- {"id": 1, "mode": "flight", "state": [...], "jacobian": [[...], ...]}
//   <- {"id": 1, "error": "what went wrong"}          instead of any answer
//
// A Jacobian has a row for each component of the new state and a column for each of [state control parameters]. Without
// one, steps are differentiated by differences, which are wider if all that is answered are numbers of float32.
//
// A scene has the one mode "discs", position and velocity of each disc as its state, and a force on each as its
// control. A simulator of scenes that "can" take "names" is asked for such steps; those make up whole motions unless it
// can "simulate" too. Other simulators of scenes must be able to simulate. Whole motions, and steps of these
// simulators, have numbers in rows, one for each disc:
//
//   -> {"id": 1, "simulate": {"steps": 480, "duration": 1, "initial": [[px,py,vx,vy],...], "control": [[[fx,fy],...]]}}
//   <- {"id": 1, "final": [[px,py,vx,vy],...]}        if it "can" give "states", and "states": true is among what is
//                                                     asked: also "states", those after 0, 1, ... of its own steps
//   -> {"id": 2, "gradient": {the same, "of_final": [[...],...]}}
//   <- {"id": 2, "final": ..., "initial": [[...],...], "control": [[[...],...],...]}
//                                                     if "parameters": true is among what is asked, and it gives them:
//                                                     also "parameters": {"mass.ball": ..., ...}, derivatives by name
//   -> {"id": 3, "step": {"h": 0.002, "state": [[...],...], "force": [[fx,fy],...]}}       a force for each disc
//   <- {"id": 3, "state": [[...],...]}
//
// A control has a row a step, with a force for each controlled disc; one row stands for the same in every step.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>

#include "saltus/audit/black_box.h"
#include "saltus/audit/hybrid_audit.h"

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
// Reads its answer. Throws ProtocolError.
BlackBoxTraits ReadHello(const std::string& line);

// Return a question without its id. The traits are those of the simulator that is asked.
ProtocolJson QuestionToJson(const Scene& scene, const Question& question, const BlackBoxTraits& traits);
ProtocolJson StepToJson(const HybridSystem& system, const SchemeStep& step, bool jacobian);
// Returns an answer as an object. Throws ProtocolError if it is none, or of another id.
ProtocolJson ReadReply(const std::string& line, std::int64_t id);
// Returns the reason in a reply without an answer; empty if there is an answer.
std::string ErrorIn(const ProtocolJson& reply);
// Reads a reply. Throws ProtocolError.
Answer AnswerFrom(const ProtocolJson& reply, const Scene& scene, const Question& question,
                  const BlackBoxTraits& traits);

// Describes a question for messages: "simulate of 480 steps".
std::string Describe(const Question& question);
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
