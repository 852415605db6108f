// Where a fit begins: segments, and their initial states from the data.
#pragma once

#include <vector>

#include "identify/segment_motion.h"

namespace saltus {

// Cuts recordings into segments of at most `length`, each of which begins with a sample; 0: one a recording, which
// begins at time 0.
std::vector<Segment> CutIntoSegments(const std::vector<Recording>& recordings, double length);

// Initial states of `free_bodies` by lines through their first samples, less what gravity and forces do, whatever a few
// outliers say; those of the others are the scene's. Discs that overlap are moved apart. In the scene's units.
std::vector<double> InitialFromData(const Scene& scene, const std::vector<Sample>& samples, const Segment& segment,
                                    const std::vector<int>& free_bodies);

}  // namespace saltus
