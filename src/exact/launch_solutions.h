// The initial velocities with which one disc among planes reaches the target exactly.
//
// Along a given sequence of planes the final position is a smooth closed form of the initial velocity (see
// closed_forms.h), so that each sequence gives two equations in two unknowns, solved by Newton's method. A solution
// counts if the disc, released with this velocity, does strike these planes and no others.
//
// Scene: Zhong, Han, Brikis, "Differentiable Physics Simulations with Contacts: Do They Have Correct Gradients w.r.t.
// Position, Velocity and Control?", 2022, task 2. SI units.
#pragma once

#include <string>
#include <vector>

#include "exact/closed_forms.h"
#include "saltus/scene/geometry.h"
#include "saltus/scene/scene.h"

namespace saltus {

struct LaunchSolution {
  Vec2d velocity = Vec2d::Zero();  // m/s
  std::vector<ExactEvent> events;  // what the disc strikes on its way
};

// The velocities of zero loss, in order of increasing speed, for all sequences of at most `max_hits` hits. Newton's
// method starts from the straight line to the target's mirror image and from a lattice around it; a solution that no
// start leads to is missed. Preconditions, else nothing and a reason in `why_not`: one moving disc; the objective is
// one squared distance of its final position, without effort.
std::vector<LaunchSolution> FindLaunchSolutions(const Scene& scene, int max_hits = 3, std::string* why_not = nullptr);

}  // namespace saltus
