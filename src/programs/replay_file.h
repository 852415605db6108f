// Saved motions, of saltus or of another simulator, as a page that plays them.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "output/replay.h"
#include "saltus/scene/scene.h"

namespace saltus {

// The motions in some files, whose discs must be the same. Bodies and planes are those of `scene`, if one is given, or
// else what the first file says of them. Throws InputError with file and key.
Replay ReadReplay(const std::vector<std::string>& paths, const std::optional<Scene>& scene);

// `saltus_replay`.
int ReplayMain(int argc, char** argv);

}  // namespace saltus
