// `saltus_bodies`: planar bodies in a file as a problem of a hybrid system.
#include <gflags/gflags.h>

#include <optional>

#include "programs/bodies_file.h"
#include "programs/program.h"
#include "scene/yaml_value.h"

DECLARE_string(scene);

namespace saltus {

int BodiesMain(int argc, char** argv) {
  return RunHybridProgram(argc, argv, FindProgram("saltus_bodies"), [] {
    if (FLAGS_scene.empty()) throw InputError("--scene=FILE is needed");
    std::optional<BodiesTask> task;
    const auto error =
        internal::ReadYamlFile(FLAGS_scene, [&](const YAML::Node& root) { task.emplace(ReadBodies(root)); });
    if (error) throw InputError(error->ToString());
    return HybridTask(*std::move(task));
  });
}

}  // namespace saltus
