#include "sweep/value.h"

#include <glog/logging.h>

#include <cmath>
#include <limits>

namespace saltus {
namespace {

SweepValue FromJson(const Json& json) {
  if (json.is_number_integer()) return json.get<int64_t>();
  if (json.is_number()) return json.get<double>();
  if (json.is_string()) return json.get<std::string>();
  return {};
}

}  // namespace

SweepValue FiniteOrNothing(double value) { return std::isfinite(value) ? SweepValue(value) : SweepValue(); }

double ToNumber(const SweepValue& value) {
  if (const auto* number = std::get_if<double>(&value)) return *number;
  if (const auto* whole = std::get_if<int64_t>(&value)) return static_cast<double>(*whole);
  return std::numeric_limits<double>::quiet_NaN();
}

Cell ToCell(const SweepValue& value) {
  if (const auto* number = std::get_if<double>(&value)) return *number;
  if (const auto* whole = std::get_if<int64_t>(&value)) return *whole;
  if (const auto* text = std::get_if<std::string>(&value)) return *text;
  return {};
}

Json ToJson(const SweepValue& value) {
  if (const auto* number = std::get_if<double>(&value)) return *number;
  if (const auto* whole = std::get_if<int64_t>(&value)) return *whole;
  if (const auto* text = std::get_if<std::string>(&value)) return *text;
  return nullptr;
}

const char* ToString(PointStatus status) {
  switch (status) {
    case PointStatus::kComputed:
      return "done";
    case PointStatus::kFailed:
      return "failed";
    case PointStatus::kNotApplicable:
      return "not_applicable";
  }
  LOG(FATAL) << "no such status";
}

std::optional<PointStatus> FindPointStatus(const std::string& text) {
  for (const PointStatus status : {PointStatus::kComputed, PointStatus::kFailed, PointStatus::kNotApplicable}) {
    if (text == ToString(status)) return status;
  }
  return std::nullopt;
}

std::string Encode(const PointResult& result) {
  Json json = Json::array({ToString(result.status)});
  for (const SweepValue& value : result.row) json.push_back(ToJson(value));
  std::string bytes;
  Json::to_cbor(json, bytes);
  return bytes;
}

PointResult DecodePointResult(const std::string& bytes) {
  const Json json = Json::from_cbor(bytes);
  PointResult result{FindPointStatus(json.at(0).get<std::string>()).value(), {}};
  for (size_t i = 1; i < json.size(); ++i) result.row.push_back(FromJson(json[i]));
  return result;
}

}  // namespace saltus
