#include "saltus/outer/audit_gradient.h"

#include <ostream>
#include <stdexcept>
#include <variant>

#include "audit/audit_text.h"
#include "saltus/scene/scene_file.h"

namespace saltus {

Scene Load(const std::string& path) {
  std::variant<Scene, SceneFileError> loaded = LoadSceneFile(path);
  if (const auto* error = std::get_if<SceneFileError>(&loaded)) throw std::invalid_argument(error->ToString());
  return std::get<Scene>(std::move(loaded));
}

GradientAudit AuditGradient(const Contact& contact, const Scene& scene, const AuditOptions& options) {
  const std::string reason = WhyNotApplicable(contact, scene);
  if (!reason.empty()) throw std::invalid_argument("AuditGradient: " + contact.name() + ": " + reason);
  GradientAudit audit{.scene = scene, .report = {.reference = ExactGradientOf(scene, options.stop), .models = {}}};
  audit.report.models.push_back(AuditModel(contact, scene, Precision::kDouble, audit.report.reference, options));
  return audit;
}

std::ostream& operator<<(std::ostream& out, const GradientAudit& audit) {
  return out << AuditText(audit.scene, audit.report, std::nullopt, LayoutOfStandardOutput());
}

}  // namespace saltus
