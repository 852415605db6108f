// Write a generated scene of many discs as a scene file.
#pragma once

namespace saltus {

// `saltus_scene`.
int SceneMain(int argc, char** argv);

}  // namespace saltus
