// MuJoCo 2: discs as spheres on two slides, half-planes as planes. Contacts are springs as stiff as `solref` says,
// without damping, which bounce elastically; MuJoCo has no coefficient of restitution.
#include <mujoco/mujoco.h>

#include <cstring>
#include <sstream>

#include "protocol.h"

namespace {

using engines::Scene;
using engines::State;

// The scene as MuJoCo's XML.
std::string Model(const Scene& scene, const std::vector<State>& initial, double h) {
  std::ostringstream xml;
  xml.precision(17);
  xml << "<mujoco><option timestep='" << h << "' gravity='" << scene.gravity[0] << " " << scene.gravity[1] << " 0'/>"
      << "<default><geom solref='-40000 0' condim='" << (scene.friction > 0 ? 3 : 1) << "' friction='" << scene.friction
      << " 0 0'/></default><worldbody>";
  for (std::size_t i = 0; i < initial.size(); ++i) {
    const engines::Body& given = scene.bodies[i];
    std::ostringstream sphere;
    sphere.precision(17);
    sphere << "<geom type='sphere' size='" << given.radius << "' mass='" << given.mass << "'";
    if (given.fixed) {
      xml << sphere.str() << " pos='" << initial[i][0] << " " << initial[i][1] << " 0'/>";
    } else {
      xml << "<body><joint type='slide' axis='1 0 0'/><joint type='slide' axis='0 1 0'/>" << sphere.str()
          << "/></body>";
    }
  }
  for (const engines::Plane& plane : scene.planes) {
    xml << "<geom type='plane' size='0 0 1' pos='" << plane.point[0] << " " << plane.point[1] << " 0' zaxis='"
        << plane.normal[0] << " " << plane.normal[1] << " 0'/>";
  }
  xml << "</worldbody></mujoco>";
  return xml.str();
}

mjModel* Load(const std::string& xml) {
  const auto files = std::make_unique<mjVFS>();
  mj_defaultVFS(files.get());
  mj_makeEmptyFileVFS(files.get(), "scene.xml", static_cast<int>(xml.size()));
  std::memcpy(files->filedata[mj_findFileVFS(files.get(), "scene.xml")], xml.data(), xml.size());
  char error[500] = "";
  mjModel* model = mj_loadXML("scene.xml", files.get(), error, sizeof(error));
  mj_deleteVFS(files.get());
  if (!model) throw std::runtime_error(error);
  return model;
}

class MujocoWorld : public engines::World {
 public:
  MujocoWorld(const Scene& scene, const std::vector<State>& initial, double h)
      : model_(Load(Model(scene, initial, h))), data_(mj_makeData(model_)) {
    int next = 0;
    for (std::size_t i = 0; i < initial.size(); ++i) {
      slides_.push_back(next);
      if (scene.bodies[i].fixed) continue;
      for (int axis = 0; axis < 2; ++axis, ++next) {
        data_->qpos[next] = initial[i][axis];
        data_->qvel[next] = initial[i][axis + 2];
      }
    }
  }
  ~MujocoWorld() override {
    mj_deleteData(data_);
    mj_deleteModel(model_);
  }

  void Push(int disc, double fx, double fy) override {
    data_->qfrc_applied[slides_[disc]] = fx;
    data_->qfrc_applied[slides_[disc] + 1] = fy;
  }
  void Step(double) override {
    mj_step(model_, data_);
    mju_zero(data_->qfrc_applied, model_->nv);
  }
  State Get(int disc) const override {
    const mjtNum *p = data_->qpos + slides_[disc], *v = data_->qvel + slides_[disc];
    return {p[0], p[1], v[0], v[1]};
  }

 private:
  mjModel* model_;
  mjData* data_;
  std::vector<int> slides_;  // by disc: the index of its slide along x, that along y follows
};

}  // namespace

int main() {
  return engines::Serve({std::string("MuJoCo ") + mj_versionString(),
                         [](const Scene& scene, const std::vector<State>& initial, double h) {
                           return std::make_unique<MujocoWorld>(scene, initial, h);
                         },
                         [](const Scene& scene) -> std::string {
                           if (scene.restitution == 1) return "";
                           return "MuJoCo has no coefficient of restitution: this driver's contacts are elastic";
                         }});
}
