// `saltus_bodies`: problems of planar bodies in files.
#include <gflags/gflags.h>

#include <optional>

#include "blackbox/protocol.h"
#include "hybrid/mechanical/bodies_file.h"
#include "programs/hybrid_program.h"
#include "scene/yaml_value.h"

DECLARE_string(scene);

namespace saltus {

int BodiesMain(int argc, char** argv) {
  return RunHybridProgram(argc, argv, FindProgram("saltus_bodies"), [] {
    if (FLAGS_scene.empty()) throw InputError("--scene=FILE is needed");
    std::optional<BodiesProblem> read;
    const auto error =
        internal::ReadYamlFile(FLAGS_scene, [&](const YAML::Node& root) { read.emplace(ReadBodies(root)); });
    if (error) throw InputError(error->ToString());
    HybridTask task{read->problem, ExtrasOf(read->bodies), read->name};
    task.extras.scene = SceneToJson(read->bodies);
    return task;
  });
}

}  // namespace saltus
