// The gradient of a scene's loss at its initial guess, or under a given control, as a contact model sees it.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/control/surrogate.h"
#include "saltus/simulate/event_sides.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/registry.h"

namespace saltus {

struct ModelGradient {
  std::string contact;
  std::string reason;  // why there is none: the model cannot take the scene, or its rollout fails, and where
  int num_steps = 0;   // K of the control's shape
  bool spins = false;  // the scene has discs that spin
  // Scales of the scene in units of the gradient: with the duration for time, entries by position, velocity per time
  // by force times mass per time squared, and angle per length have one unit.
  double duration = 1, mass = 1, length = 1, loss_scale = 1;
  double loss = 0;
  Sensitivity gradient;       // of the loss, effort included
  std::vector<Event> events;  // if the model resolves impact times
  int num_touches = 0;        // pairs that touch, summed over all steps
  int unresolved_steps = 0;   // of an event-driven model (events.h); if any, it is not exact
  // Entries of an exact gradient by the initial state that are derivatives from one side, or from none.
  std::vector<OneSided> one_sided;

  // Where another order of impacts at the same time leads elsewhere: the gradient is that of one order, and the loss
  // jumps.
  std::vector<Tie> ambiguous;        // of models that resolve impact times
  std::optional<LossSpread> spread;  // of the loss over the orders; of ExactGradientOf() only

  // If set, `gradient` is biased: this surrogate of the loss's derivative, not the derivative itself.
  std::optional<Surrogate> surrogate;
  // Standard errors of the entries of a smoothed gradient, which has none by parameters; else empty.
  std::vector<double> initial_error, control_error;

  bool ok() const { return reason.empty(); }
};

// Sets the scales of a gradient: those of the scene.
void SetScales(const Scene& scene, ModelGradient* gradient);

// An unknown model and a wrong scene are reasons too. Here and below, one that was stopped has the reason kStopped. A
// `control` (K x C x 2) replaces the initial guess; one of another size is a reason.
ModelGradient ComputeGradient(const Contact& contact, const Scene& scene, Precision precision,
                              const StopRequest& stop = nullptr, const std::vector<double>* control = nullptr);

// A surrogate of it, its samples on `threads` threads. The initial state and the control are perturbed one at a time,
// each as a whole. A surrogate that is not valid is a reason too.
ModelGradient ComputeSurrogate(const Contact& contact, const Scene& scene, Precision precision,
                               const Surrogate& surrogate, int threads = 1, const StopRequest& stop = nullptr);

}  // namespace saltus
