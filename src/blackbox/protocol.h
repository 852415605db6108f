// JSON lines between a program that asks and a simulator that answers: one object a line, answers in order.
//
//   -> {"saltus": 1, "scene": {...}}                  the scene file as JSON, with defaults filled in
//   <- {"name": "mine 1.0", "can": ["gradient"]}      optional: "gradient", "step", "states"; "not_applicable": "why";
//                                                     "grid_steps": n, if numbers of steps must be multiples of it
//   -> {"id": 1, "simulate": {"steps": 480, "duration": 1, "initial": [[px,py,vx,vy],...], "control": [[[fx,fy],...]]}}
//   <- {"id": 1, "final": [[px,py,vx,vy],...]}        if it gives states, and "states": true is among what is asked:
//                                                     also "states", those after 0, 1, ... of its own steps
//   -> {"id": 2, "gradient": {the same, "of_final": [[...],...]}}
//   <- {"id": 2, "final": ..., "initial": [[...],...], "control": [[[...],...],...]}
//                                                     if "parameters": true is among what is asked, and it gives them:
//                                                     also "parameters": {"mass.ball": ..., ...}, derivatives by name
//   -> {"id": 3, "step": {"h": 0.002, "state": [[...],...], "force": [[fx,fy],...]}}       a force for each disc
//   <- {"id": 3, "state": [[...],...]}
//   <- {"id": 3, "error": "what went wrong"}          instead of an answer
//
// A control has a row a step, with a force for each controlled disc; one row stands for the same in every step.
#pragma once

#include <cstdint>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>

#include "saltus/audit/black_box.h"

namespace saltus {

using ProtocolJson = nlohmann::ordered_json;

// The exception for an unexpected answer: its message has what was expected and what arrived.
struct ProtocolError : std::runtime_error {
  using std::runtime_error::runtime_error;
};

// Returns the line that greets the simulator, without its end.
std::string HelloLine(const Scene& scene);
// Returns the line of a question, without its end. `traits` are those of the simulator that is asked.
std::string QuestionLine(const Scene& scene, const Question& question, std::int64_t id,
                         const BlackBoxTraits& traits = {});

// Read a greeting and an answer; both throw ProtocolError.
BlackBoxTraits ReadHello(const std::string& line);
Answer ReadAnswer(const std::string& line, const Scene& scene, const Question& question, std::int64_t id,
                  const BlackBoxTraits& traits);

// Describes a question for messages: "request 7, simulate 480 steps".
std::string Describe(const Question& question, std::int64_t id);
// Returns the beginning of a text, in quotes and without unprintable characters: at most 80 characters.
std::string Excerpt(const std::string& text);

// Returns numbers in rows of `width`: [[a, b], [c, d]].
ProtocolJson RowsToJson(const std::vector<double>& numbers, std::size_t width);
// Returns rows of rows of a control, with `discs` controlled discs a step.
ProtocolJson ControlRowsToJson(const std::vector<double>& control, std::size_t discs);
// Returns the numbers of nested lists of that shape, all finite. `what` is for the message of ProtocolError.
std::vector<double> NumbersFrom(const ProtocolJson& json, const std::vector<std::size_t>& shape,
                                const std::string& what);

}  // namespace saltus
