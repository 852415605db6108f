// Scene files and audits of gradients in one line each.
//
//   const saltus::Scene scene = saltus::Load("two_balls.yaml");
//   std::cout << saltus::AuditGradient(Springs(), scene);
#pragma once

#include <iosfwd>
#include <string>
#include <utility>

#include "saltus/audit/audit.h"
#include "saltus/scene/scene.h"
#include "saltus/simulate/force_model.h"

namespace saltus {

// Reads a scene file (scene_file.h). Throws std::invalid_argument with file, line, key, what was found and what was
// expected.
Scene Load(const std::string& path);

// The gradient of a contact model beside the exact one.
struct GradientAudit {
  Scene scene;
  AuditReport report;  // of one model

  const ModelAudit& model() const { return report.models.front(); }
};
// Prints the tables that the program saltus_audit prints.
std::ostream& operator<<(std::ostream& out, const GradientAudit& audit);

// Audits the gradient of the scene's loss under a contact model, in double precision. Throws std::invalid_argument if
// the model does not support the scene.
GradientAudit AuditGradient(const Contact& contact, const Scene& scene, const AuditOptions& options = {});
// Audits the gradient under a struct with Force (force_model.h), or under a model as contact/contact_model.h describes.
template <typename M>
requires(!std::convertible_to<M, Contact>) GradientAudit
    AuditGradient(M model, const Scene& scene, const AuditOptions& options = {}) {
  if constexpr (ContactModel<M>) {
    return AuditGradient(UserContact(std::move(model)), scene, options);
  } else {
    return AuditGradient(ForceContact(std::move(model)), scene, options);
  }
}

}  // namespace saltus
