// Saved motions, of saltus or of another simulator, as a page that plays them.
#pragma once

#include <optional>
#include <string>

#include "programs/scene_drawing.h"

namespace saltus {

// Reads NPZ or JSON:
//
//   bodies   [{ "name", "radius", "fixed" }]          fixed is false unless given
//   planes   [{ "name", "point", "normal" }]          default none; likewise segments, polygons, arcs and pockets as
//                                                     in scene files
//   times    n numbers that do not fall, s
//   states   n x B x [p_x, p_y, v_x, v_y]; without velocities, these are differences of the positions; of discs
//            that spin angle and angular velocity follow, and what follows then is not looked at
//   touches  [{ "a", "b", "begin", "end", "impulse" }], default none; end (begin) and impulse ([0, 0]) may be missing
//
// and the same with "exact_" before them, for arcs of constant acceleration between the times; or a list "runs" of
// such, with "contact" and "solver", as saltus_solve --json --states prints them. In NPZ files, as saltus_solve writes
// them, bodies are "scene" (the text of a scene file) or "radius" (B) and "name" (B). Throws InputError with the key.
// `scene` stands in for what the file says of bodies. The model of a motion is empty if the file names none.
Replay ReadReplayFile(const std::string& path, const std::optional<Scene>& scene);

}  // namespace saltus
