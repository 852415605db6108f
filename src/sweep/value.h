// One entry of a sweep's table, and what one point of a sweep came to.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "output/table.h"
#include "programs/json_output.h"

namespace saltus {

// Nothing, a whole number, a number (finite) or text.
using SweepValue = std::variant<std::monostate, int64_t, double, std::string>;
using SweepRow = std::vector<SweepValue>;

// A number, or nothing if it is not finite.
SweepValue FiniteOrNothing(double value);

// The number, or NaN for nothing and for text.
double ToNumber(const SweepValue& value);

Cell ToCell(const SweepValue& value);
Json ToJson(const SweepValue& value);

enum class PointStatus { kComputed, kFailed, kNotApplicable };

// "done", "failed", "not_applicable"; and back.
const char* ToString(PointStatus status);
std::optional<PointStatus> FindPointStatus(const std::string& text);  // none if there is no such

// One row of a sweep's table, with an entry per column.
struct PointResult {
  PointStatus status = PointStatus::kComputed;
  SweepRow row;

  bool operator==(const PointResult&) const = default;
};

// As bytes (CBOR, RFC 8949), to send between processes; every double keeps its bits. Precondition of the latter: bytes
// that the former made.
std::string Encode(const PointResult& result);
PointResult DecodePointResult(const std::string& bytes);

}  // namespace saltus
