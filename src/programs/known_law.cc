#include "programs/known_law.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "base/csv.h"
#include "programs/program.h"

namespace saltus {
namespace {

double ReadNumber(const std::string& text, const std::string& where) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) {
    throw InputError(where + ": found '" + text + "', expected a finite number");
  }
  return value;
}

}  // namespace

std::optional<double> KnownLaw::At(double at) const {
  const auto above = std::lower_bound(speed.begin(), speed.end(), at);
  if (above == speed.end() || at < speed.front()) return std::nullopt;
  const auto i = std::max<std::ptrdiff_t>(1, above - speed.begin());
  const double share = (at - speed[i - 1]) / (speed[i] - speed[i - 1]);
  return restitution[i - 1] + share * (restitution[i] - restitution[i - 1]);
}

KnownLaw ReadKnownLaw(const std::string& path) {
  const StatusOr<CsvDocument> csv = ReadCsv(path);
  if (!csv.ok()) throw InputError(csv.status().message());
  const auto speed = csv->Find("speed"), restitution = csv->Find("restitution");
  if (!speed || !restitution) throw InputError(path + ": expected the columns speed and restitution");
  KnownLaw law;
  for (std::size_t i = 0; i < csv->rows.size(); ++i) {
    const std::string line = path + ":" + std::to_string(csv->lines[i]) + ": ";
    const double v = ReadNumber(csv->rows[i][*speed], line + "speed");
    const double e = ReadNumber(csv->rows[i][*restitution], line + "restitution");
    if (v < 0 || (i > 0 && v <= law.speed.back())) throw InputError(line + "speed: expected speeds >= 0 that rise");
    if (e < 0 || e > 1) throw InputError(line + "restitution: expected a number in [0, 1]");
    law.speed.push_back(v);
    law.restitution.push_back(e);
  }
  if (law.speed.size() < 2)
    throw InputError(path + ": found fewer than two rows, expected a law at two speeds or more");
  return law;
}

}  // namespace saltus
