// The functions of control/phase_costs.h for Ceres, with derivatives by Jets.
#pragma once

#include <ceres/autodiff_cost_function.h>
#include <ceres/dynamic_autodiff_cost_function.h>

#include <memory>
#include <span>
#include <utility>

namespace saltus {

// Makes a cost function with a number of blocks that is known as the program runs.
template <typename Function>
std::unique_ptr<ceres::CostFunction> Dynamic(Function function, int rows, std::span<const int> block_sizes) {
  constexpr int kStride = 4;  // derivatives in one pass
  auto cost =
      std::make_unique<ceres::DynamicAutoDiffCostFunction<Function, kStride>>(new Function(std::move(function)));
  for (const int size : block_sizes) cost->AddParameterBlock(size);
  cost->SetNumResiduals(rows);
  return cost;
}

// Makes a cost function of Function::kRows rows and these blocks.
template <int... kBlocks, typename Function>
std::unique_ptr<ceres::CostFunction> Sized(Function function) {
  constexpr int kRows = Function::kRows;
  return std::make_unique<ceres::AutoDiffCostFunction<Function, kRows, kBlocks...>>(new Function(std::move(function)));
}

}  // namespace saltus
