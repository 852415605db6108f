// Scenes and their motions as figures and replays.
#pragma once

#include <string>
#include <vector>

#include "output/figure.h"
#include "output/replay.h"
#include "programs/motion.h"
#include "saltus/scene/scene.h"

namespace saltus {

// Draws discs at their start, walls and targets.
Panel ScenePanel(const Scene& scene, const std::string& title);

// The most numbers of states that fit into a page: about 3 MB.
inline constexpr std::size_t kMostReplayNumbers = std::size_t{1} << 21;

// The scene's walls, their parts in the order of WallPartsOf(). Precondition: ValidateStructure(scene) finds nothing.
void AddWalls(const Scene& scene, Replay* replay);

// The discs, walls and targets of a scene, without motions.
Replay ReplayOf(const Scene& scene);

// Returns how many nodes each of `motions` motions may have in a page.
MotionOptions ReplayOptions(const Scene& scene, std::size_t motions);

// Splits rows (control_rows.h) into forces and torques.
void SplitControl(const Scene& scene, const std::vector<double>& rows, ReplayMotion* motion);

// `input` is what the motion was simulated from: its control is drawn too. Precondition: the motion has states.
ReplayMotion ToReplayMotion(const Scene& scene, const Motion& motion, const MotionInput& input,
                            const std::string& label, std::string_view style_of_model);

}  // namespace saltus
