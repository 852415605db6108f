// Rows of data/published.csv, and the same quantities computed with a contact model of this project.
#pragma once

#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <sstream>
#include <string>
#include <variant>
#include <vector>

#include "saltus/control/single_shooting.h"
#include "saltus/dynamics/registry.h"
#include "saltus/io/scene_file.h"

namespace saltus::contact_test {

inline Scene LoadProblem(const std::string& name) {
  return std::get<Scene>(LoadSceneFile(SALTUS_SOURCE_DIR "/problems/" + name + ".yaml"));
}

struct PublishedRow {
  std::string problem, contact, quantity;
  double friction, expected, tolerance;
  Precision precision;
};

inline std::vector<PublishedRow> PublishedRows(const std::string& contact) {
  std::ifstream file(SALTUS_SOURCE_DIR "/data/published.csv");
  std::vector<PublishedRow> rows;
  for (std::string line; std::getline(file, line);) {
    std::vector<std::string> cells;
    std::istringstream stream(line);
    for (std::string cell; std::getline(stream, cell, ',');) cells.push_back(cell);
    if (cells.size() < 9 || cells[3] != contact) continue;
    rows.push_back({cells[1],
                    cells[3],
                    cells[5],
                    std::stod(cells[2]),
                    std::stod(cells[7]),
                    std::stod(cells[8]),
                    cells[4] == "float" ? Precision::kFloat : Precision::kDouble});
  }
  return rows;
}

// Gradient descent as published: 1000 updates; in single precision variables and updates are rounded to float.
struct Descent {
  double last_loss;  // before the last update
  std::vector<double> variables;
};
inline Descent Descend(SingleShooting& shooting, double rate, bool single) {
  Descent result{0, shooting.initial_guess()};
  std::vector<double> gradient(result.variables.size());
  for (int iteration = 0; iteration < 1000; ++iteration) {
    EXPECT_TRUE(shooting.Evaluate(result.variables, &result.last_loss, gradient.data()));
    for (size_t i = 0; i < gradient.size(); ++i) {
      double& z = result.variables[i];
      z = single ? float(z) - float(rate) * float(gradient[i]) : z - rate * gradient[i];
    }
  }
  return result;
}

inline double Compute(const PublishedRow& row) {
  Scene scene = LoadProblem(row.problem);
  scene.contact.friction = row.friction;
  SingleShooting shooting(MakeSimulator(row.contact, scene, row.precision));
  const bool single = row.precision == Precision::kFloat;
  if (row.quantity == "loss_999") return Descend(shooting, 10, single).last_loss;
  if (row.quantity == "v_x_1000") return Descend(shooting, 0.01, single).variables[0];
  if (row.quantity == "v_y_1000") return Descend(shooting, 0.01, single).variables[1];
  double loss;
  Sensitivity gradient;
  EXPECT_TRUE(shooting.EvaluateAll(shooting.initial_guess(), &loss, &gradient));
  if (row.quantity == "dloss/dp_y") return gradient.initial[1];
  if (row.quantity == "dloss/dv_x" || row.quantity == "dloss/dv1_x") return gradient.initial[2];
  if (row.quantity == "dloss/dv_y") return gradient.initial[3];
  if (row.quantity == "dloss/dp1_x") return gradient.initial[0];
  if (row.quantity == "dloss/dp2_x") return gradient.initial[4];
  if (row.quantity == "dloss/dv2_x") return gradient.initial[6];
  if (row.quantity == "dloss/du0_y") return gradient.control[1];
  if (row.quantity == "dloss/du1_0_x") return gradient.control[0];
  ADD_FAILURE() << "unknown quantity " << row.quantity;
  return 0;
}

inline void ExpectPublished(const std::string& contact) {
  const std::vector<PublishedRow> rows = PublishedRows(contact);
  EXPECT_GE(rows.size(), 13u);
  for (const PublishedRow& row : rows) {
    EXPECT_NEAR(Compute(row), row.expected, row.tolerance)
        << row.problem << " friction " << row.friction << " " << row.quantity;
  }
}

}  // namespace saltus::contact_test
