// The gradient of a loss as every contact model sees it, beside the exact one.
//
// The exact gradient is that of the event-driven model; where that one cannot take the scene, a closed form; where
// there is none either, the models stand alone.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "saltus/audit/gradients.h"

namespace saltus {

// How far a gradient is from the exact one, over initial positions, initial velocities and the control. Controls on
// different grids are compared as forces held over the coarser intervals.
struct GradientError {
  double relative = 0;  // |g - g_exact| / |g_exact|
  double angle = 0;     // between the two, rad
};
// Precondition: both are ok and of the same scene; the control grid of one is a refinement of the other's.
GradientError CompareGradients(const ModelGradient& gradient, const ModelGradient& exact);

// The gradient with respect to forces held over `intervals` equal parts of the horizon: the sum over the steps of each.
// `control` is K x C x 2 with K = steps, a multiple of `intervals`.
std::vector<double> CoarsenControl(const std::vector<double>& control, int steps, int intervals);

struct ModelAudit {
  ModelGradient gradient;
  std::optional<GradientError> error;  // if there is a gradient and a reference
};

struct AuditReport {
  std::optional<ModelGradient> reference;  // contact is "event", or "closed form"
  std::vector<ModelAudit> models;
};

// The exact gradient of a scene, or nothing.
std::optional<ModelGradient> ExactGradientOf(const Scene& scene);

}  // namespace saltus
