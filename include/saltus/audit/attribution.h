// Where the error of a model's gradient comes from, and why.
//
// A rollout of the model is cut at its contacts. Each becomes an interval of whole steps that begins and ends without
// overlap: a single step for an impulse, many for a spring. Over the interval the model's linearization, composed of
// those of its steps, stands beside that of the exact flow from the same state under the same forces:
//
//   dx_end = A dx_begin + B du        error = |(A - A_exact)^T lambda| / |A_exact^T lambda|
//
// with lambda the model's own costate (the derivative of the loss with respect to the state) at the end: the error that
// this contact alone puts into the gradient. Derivatives by velocities are divided by the duration, to have one unit.
//
// The cause is recognised from the numbers. The exact linearization of an impact is known in closed form (the saltation
// matrix); where the model's equals that formula with a term dropped or changed, this term is the cause. Where it does
// not, the model itself is run over the interval with far smaller steps: an error that falls was a force that the steps
// do not resolve.
//
// Effects of finite steps alone are told apart by doing all of this once more with at least eight times the steps.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "saltus/simulate/registry.h"

namespace saltus {

// Part of a linearization, named by its rows and columns.
enum class Block { kPositionFromPosition, kVelocityFromPosition, kPositionFromVelocity, kVelocityFromVelocity };
const char* BlockToString(Block block);  // "velocity from position"

struct ContactError {
  int first_step = 0, last_step = 0;           // those steps of the model in which it reports the contact
  std::string a, b;                            // a disc, and a disc or plane; the first pair if there are several
  int exact_impacts = 0;                       // that the exact flow has in the interval
  double error = 0;                            // as above
  bool stays = false;                          // with far smaller steps it is more than a quarter of this
  Block block = Block::kPositionFromPosition;  // that contributes most to it
  std::string why;                             // in words; empty if the error is small or does not stay
};

struct Attribution {
  std::string reason;                  // why there is none: no exact flow, or a rollout that fails
  std::vector<ContactError> contacts;  // in order of time, at most kMostContacts of them
  int first_wrong = -1;  // index of the first contact whose error is not small and stays; -1 if there is none
  std::string sequence;  // how the contacts differ from the exact ones; empty if they do not
  std::string limit;     // what the limit of time has kept it from, in words; empty if nothing

  static constexpr int kMostContacts = 64;

  bool ok() const { return reason.empty(); }
};

struct AttributionOptions {
  StopRequest stop = nullptr;  // what was stopped is of no use
  // Limit of time; 0: none. The contacts compared until then are kept, half of the time being for the scene's own
  // steps.
  double seconds = 0;
  // Called for a person, with what it is at; by one thread at a time.
  std::function<void(const std::string&)> status = nullptr;
  // On which contacts are compared; results are the same for any number. More than one needs a contact model whose
  // simulators may run at the same time, as all in the registry.
  int threads = 1;
};

// At the scene's own steps, initial state and control. Where the model cannot take the scene, that is the reason.
// Preconditions: options.seconds >= 0, options.threads > 0.
Attribution AttributeError(const Contact& contact, const Scene& scene, const AttributionOptions& options = {});

}  // namespace saltus
