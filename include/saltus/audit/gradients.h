// The gradient of a scene's loss under a contact model, at the initial guess or under a given control.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/control/surrogate.h"
#include "saltus/simulate/events.h"
#include "saltus/simulate/exact_run.h"
#include "saltus/simulate/one_sided_derivatives.h"
#include "saltus/simulate/registry.h"

namespace saltus {

// The gradient of a scene's loss under one contact model, in the scene's units.
struct ModelGradient {
  std::string contact;
  std::string
      reason;         // why there is no gradient: the model does not support the scene, or its rollout fails, and where
  int num_steps = 0;  // K of the control's shape
  bool spins = false;  // the scene has discs that spin
  // Scales of the scene in units of the gradient. With time measured by the duration, derivatives by position, by
  // velocity divided by time, by force times mass divided by time squared, and by angle divided by length have one
  // unit.
  double duration = 1, mass = 1, length = 1, loss_scale = 1;
  double loss = 0;
  Sensitivity gradient;       // of the loss, effort included; shapes as in simulator.h with K = num_steps
  std::vector<Event> events;  // if the model resolves impact times
  std::vector<Event> grazes;  // where the gradient is that of motions that pass by, if asked for
  int num_touches = 0;        // pairs that touch, summed over all steps
  int unresolved_steps = 0;   // steps by the time-stepping fallback (events.h); with any, the gradient is not exact
  // Entries of an exact gradient by the initial state that are one-sided derivatives, or that do not exist.
  std::vector<OneSided> one_sided;

  // Simultaneous impacts whose order changes the motion; the gradient is that of one order, and the loss jumps there.
  std::vector<Tie> ambiguous;        // empty for models that resolve no impact times
  std::optional<LossSpread> spread;  // of the loss over the orders; set by ComputeExactGradient() only

  // If set, `gradient` is this surrogate of the derivative of the loss, and is biased.
  std::optional<Surrogate> surrogate;
  // Standard errors of the entries of a smoothed gradient, in the shapes of gradient.initial and gradient.control; it
  // has no derivatives by parameters. Empty for other gradients.
  std::vector<double> initial_error, control_error;

  bool ok() const { return reason.empty(); }
};

// Sets spins, duration, mass, length and loss_scale: the natural units of the scene (scene/units.h) in its units.
void SetScales(const Scene& scene, ModelGradient* gradient);

// Computes the gradient. ModelGradient::reason also reports an unknown model, a wrong scene, and with kStopped that it
// was stopped. A `control` of K rows of control_width() numbers replaces the initial guess; one of another size is
// reported in the reason, as are path costs, a free duration and constraints, which have no gradient here.
// `with_grazes`: finds the grazes too, of a model that resolves impact times.
ModelGradient ComputeGradient(const Contact& contact, const Scene& scene, Precision precision,
                              const StopRequest& stop = nullptr, const std::vector<double>* control = nullptr,
                              bool with_grazes = false);

// Computes a surrogate of the gradient, with its samples on `threads` threads. The initial state and the control are
// perturbed one at a time, each as a whole. A surrogate that is not valid is reported in the reason.
ModelGradient ComputeSurrogate(const Contact& contact, const Scene& scene, Precision precision,
                               const Surrogate& surrogate, int threads = 1, const StopRequest& stop = nullptr);

}  // namespace saltus
