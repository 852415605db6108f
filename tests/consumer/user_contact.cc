// A user's own contact model, solved and audited by an installed saltus. Without damping and friction it is the
// library's compliant_warp: exit code 0 if both do the same.
#include "saltus/simulate/user_contact.h"

#include <cmath>
#include <iostream>

#include "own_model.h"
#include "saltus/audit/audit.h"
#include "saltus/scene/scene_file.h"
#include "saltus/solve/solver.h"

int main(int argc, char** argv) {
  if (argc != 2) {
    std::cerr << "usage: own_contact two_balls.yaml\n";
    return 2;
  }
  const auto loaded = saltus::LoadSceneFile(argv[1]);
  if (const auto* error = std::get_if<saltus::SceneFileError>(&loaded)) {
    std::cerr << error->ToString() << '\n';
    return 2;
  }
  auto scene = std::get<saltus::Scene>(loaded);
  scene.contact.damping = scene.contact.friction = 0;

  const saltus::Contact own = saltus::UserContact<OwnModel>();
  const auto solve = [&](const saltus::Contact& contact) {
    return saltus::Solve("ceres_lbfgs", {.scene = scene, .contact = contact}, {.limits = {.iterations = 20}});
  };
  const saltus::SolveReport mine = solve(own), theirs = solve("compliant_warp");
  std::cout << mine.contact << ": loss " << mine.guess.loss << " -> " << mine.solution.loss << "\n"
            << theirs.contact << ": loss " << theirs.guess.loss << " -> " << theirs.solution.loss << "\n";
  const bool same_loss = mine.solution.loss < mine.guess.loss && mine.contact == "own_model" &&
                         std::abs(mine.solution.loss - theirs.solution.loss) < 1e-9 * theirs.solution.loss;

  const auto exact = saltus::ComputeExactGradient(scene);
  const auto audit = [&](const saltus::Contact& contact) {
    return saltus::AuditModel(contact, scene, saltus::Precision::kDouble, exact);
  };
  const saltus::ModelAudit my_audit = audit(own), their_audit = audit("compliant_warp");
  std::cout << my_audit.gradient.contact << ": " << saltus::VerdictToString(my_audit.verdict) << ", "
            << saltus::VerdictToString(their_audit.verdict) << "\n";
  const bool same_verdict = my_audit.gradient.ok() && my_audit.verdict == their_audit.verdict &&
                            my_audit.verdict != saltus::Verdict::kUnknown;
  return same_loss && same_verdict ? 0 : 1;
}
