// JSON documents, and how members of structs, vectors and matrices become parts of them.
#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>
#include <optional>

// A vector as the list of its numbers, any other matrix as the list of its rows.
template <int R, int C, int Options, int MostR, int MostC>
struct nlohmann::adl_serializer<Eigen::Matrix<double, R, C, Options, MostR, MostC>> {
  static void to_json(ordered_json& json, const Eigen::Matrix<double, R, C, Options, MostR, MostC>& matrix) {
    json = ordered_json::array();
    for (Eigen::Index i = 0; i < matrix.rows(); ++i) {
      if constexpr (C == 1) {
        json.push_back(matrix[i]);
      } else {
        json.push_back(Eigen::VectorXd(matrix.row(i)));
      }
    }
  }
};

namespace saltus {

// A document may have numbers that are not finite; printing it, or passing it to Python, makes null of them.
using Json = nlohmann::ordered_json;

// Adds members of a struct under their own names: SALTUS_ADD_MEMBERS(&item, report, iterations, seconds). A
// std::optional without a value is left out.
template <typename T>
void AddMember(const char* name, const T& value, Json* to) {
  (*to)[name] = value;
}
template <typename T>
void AddMember(const char* name, const std::optional<T>& value, Json* to) {
  if (value) (*to)[name] = *value;
}
#define SALTUS_ADD_MEMBER(name) saltus::AddMember(#name, members_of.name, members_to);
#define SALTUS_ADD_MEMBERS(to, of, ...)                                       \
  [](saltus::Json* members_to, const auto& members_of) {                      \
    NLOHMANN_JSON_EXPAND(NLOHMANN_JSON_PASTE(SALTUS_ADD_MEMBER, __VA_ARGS__)) \
  }(to, of)

// Rounds all numbers to so many significant digits; those that are not finite become null.
void Round(int significant_digits, Json* json);

}  // namespace saltus
