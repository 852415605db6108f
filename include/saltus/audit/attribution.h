// Attribution of the error of a contact model's gradient to contacts of the motion, with the cause of each.
//
// A rollout of the model is divided at its contacts. Each contact is an interval of whole steps that begins and ends
// without overlap: a single step for an impulse, many for a spring. Over the interval the model's linearization, which
// is composed of those of its steps, is compared with that of the exact flow from the same state under the same forces:
//
//   dx_end = A dx_begin + B du        error = |(A - A_exact)^T lambda| / |A_exact^T lambda|
//
// Here lambda is the model's own costate (the derivative of the loss with respect to the state) at the end. The error
// is the one that this contact alone adds to the gradient. Derivatives by velocities are divided by the duration, so
// that all have one unit.
//
// The cause follows from the numbers. The exact linearization of an impact has a closed form (the saltation matrix). If
// the model's is that formula with a term missing or changed, this term is the cause. Otherwise the model itself is run
// over the interval with far smaller steps: if the error decreases, the steps do not resolve a force.
//
// All of this is computed a second time with at least eight times the steps: an error that decreases is due to finite
// steps alone.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "saltus/simulate/registry.h"

namespace saltus {

// A block of a linearization: "velocity from position" is d(velocity at the end)/d(position at the beginning).
enum class Block { kPositionFromPosition, kVelocityFromPosition, kPositionFromVelocity, kVelocityFromVelocity };
const char* BlockToString(Block block);  // "velocity from position"

struct ContactError {
  int first_step = 0, last_step = 0;  // first and last step in which the model reports the contact
  Candidate pair = {};                // the first pair if there are several; indices of the scene
  std::string a, b;                   // their names
  int exact_impacts = 0;              // number of impacts of the exact flow in the interval
  double error = 0;                   // relative error of the costate, defined at the top of this file
  bool stays = false;                 // whether it is above 1e-3 and a quarter of it is left with far smaller steps
  Block block = Block::kPositionFromPosition;  // the block that contributes most to the error
  std::string cause;  // in words; empty if the error is small, or that of an impulse and does not stay
};

struct Attribution {
  std::string reason;                  // why there is no attribution: no exact flow, or a rollout that fails
  std::vector<ContactError> contacts;  // in order of time, at most kMostContacts of them
  // Index into `contacts` of the first whose error is above 1e-3 and stays or, for a force over several steps, need not
  // stay; -1 if there is none.
  int first_wrong = -1;
  std::string sequence;  // how the contacts differ from the exact ones; empty if they do not
  std::string limit;     // what was not compared because of the limit of time, in words; empty if nothing

  static constexpr int kMostContacts = 64;

  bool ok() const { return reason.empty(); }
};

struct AttributionOptions {
  StopRequest stop = nullptr;  // an attribution that was stopped has no meaning
  // Limit of time, s; 0: none. Contacts that were compared until then are kept. Half of the time is for the scene's own
  // steps.
  double seconds = 0;
  // Receives a line about what is being computed, for a user to read; called by one thread at a time.
  std::function<void(const std::string&)> status = nullptr;
  // Number of threads that compare contacts; results do not depend on it. More than one needs a contact model whose
  // simulators may run at the same time, as those of all models of the registry may.
  int threads = 1;
};

// Attributes the error of the gradient at the scene's own steps, initial state and control. If the model does not
// support the scene, `reason` states it. Preconditions: options.seconds >= 0, options.threads > 0.
Attribution AttributeError(const Contact& contact, const Scene& scene, const AttributionOptions& options = {});

}  // namespace saltus
