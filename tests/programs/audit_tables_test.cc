// Tables of audits that ended early.
#include <gtest/gtest.h>

#include "programs/audit.h"

namespace saltus {
namespace {

// Where the first rollout of a refinement fails, there is a reason and no number to judge by.
TEST(VerdictTable, AStudyWithoutLevelsHasNoVerdicts) {
  ModelAudit audit;
  audit.gradient.contact = "primal_descent";
  audit.refinement.emplace().reason = "with 248 steps, the rollout fails";
  for (const Quantity quantity : {Quantity::kPosition, Quantity::kVelocity}) {
    QuantityStudy& study = audit.refinement->quantities.emplace_back();
    study.quantity = quantity;
    study.exact = {1, 0};
  }
  const std::string csv = VerdictTable({.reference = std::nullopt, .models = {audit}}).ToCsv();
  EXPECT_EQ(csv.substr(csv.find('\n') + 1), "primal_descent,unknown,,,,,,,,\"with 248 steps, the rollout fails\"\n");
}

}  // namespace
}  // namespace saltus
