#include "sweep/output.h"

#include <algorithm>
#include <map>

namespace saltus {
namespace {

constexpr size_t kMostReasons = 10;

int64_t CountStatus(const std::vector<StoredPoint>& points, PointStatus status) {
  return std::count_if(
      points.begin(), points.end(), [&](const StoredPoint& point) { return point.result.status == status; });
}

// What is text in no row is a column of numbers.
bool IsTextColumn(const std::vector<StoredPoint>& points, size_t column) {
  return std::any_of(points.begin(), points.end(), [&](const StoredPoint& point) {
    return std::holds_alternative<std::string>(point.result.row[column]);
  });
}

NpyArray ColumnArray(const std::vector<StoredPoint>& points, size_t column) {
  NpyArray array{{static_cast<int64_t>(points.size())}, {}};
  if (IsTextColumn(points, column)) {
    std::vector<std::string> texts;
    for (const StoredPoint& point : points) texts.push_back(ToCell(point.result.row[column]).Exact());
    array.data = std::move(texts);
  } else {
    std::vector<double> numbers;
    for (const StoredPoint& point : points) numbers.push_back(ToNumber(point.result.row[column]));
    array.data = std::move(numbers);
  }
  return array;
}

struct Reason {
  std::string text;
  int64_t count = 0;
  const StoredPoint* first = nullptr;
};

// Most frequent first, equally frequent ones by their first point.
std::vector<Reason> Reasons(const std::vector<StoredPoint>& points) {
  std::map<std::string, Reason> by_text;
  for (const StoredPoint& point : points) {
    if (point.result.status == PointStatus::kComputed) continue;
    Reason& reason = by_text[ToCell(point.result.row.back()).Exact()];
    if (reason.first == nullptr) reason.first = &point;
    ++reason.count;
  }
  std::vector<Reason> reasons;
  for (auto& [text, reason] : by_text) {
    reason.text = text.empty() ? "no reason given" : text;
    reasons.push_back(reason);
  }
  std::sort(reasons.begin(), reasons.end(), [](const Reason& a, const Reason& b) {
    return a.count != b.count ? a.count > b.count : a.first->point < b.first->point;
  });
  return reasons;
}

}  // namespace

std::string PlaceOf(const SweepStudy& study, int64_t point) {
  const SweepRow row = study.Values(point);
  std::string values;
  for (size_t i = 0; i < row.size(); ++i) {
    values += (i > 0 ? ", " : "") + study.options()[i] + "=" + ToCell(row[i]).Exact();
  }
  return "point " + std::to_string(point) + " (" + values + ")";
}

std::vector<StoredPoint> AllPoints(const SweepStore& store) {
  std::vector<StoredPoint> points;
  store.ForEach([&](int64_t point, PointResult result) { points.push_back({point, std::move(result)}); });
  return points;
}

Table SweepTable(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  std::vector<Column> columns;
  for (const std::string& name : study.columns()) columns.push_back({name});
  Table table(columns);
  for (const StoredPoint& point : points) {
    std::vector<Cell> row;
    for (const SweepValue& value : point.result.row) row.push_back(ToCell(value));
    table.AddRow(std::move(row));
  }
  return table;
}

NpzArrays SweepArrays(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  NpzArrays arrays;
  std::vector<int64_t> numbers;
  for (const StoredPoint& point : points) numbers.push_back(point.point);
  arrays["point"] = {{static_cast<int64_t>(points.size())}, std::move(numbers)};
  for (size_t i = 0; i < study.columns().size(); ++i) arrays[study.columns()[i]] = ColumnArray(points, i);
  return arrays;
}

Json SweepJson(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  Json list = Json::array();
  for (const StoredPoint& point : points) {
    Json object = {{"point", point.point}};
    for (size_t i = 0; i < study.columns().size(); ++i) object[study.columns()[i]] = ToJson(point.result.row[i]);
    object["status"] = ToString(point.result.status);
    list.push_back(std::move(object));
  }
  Json document = Json::object();
  if (!study.generates()) document["scene"] = study.request().scene.name;
  document["points"] = std::move(list);
  return document;
}

std::string Summary(const SweepStudy& study, const std::vector<StoredPoint>& points) {
  const int64_t failed = CountStatus(points, PointStatus::kFailed);
  const int64_t not_applicable = CountStatus(points, PointStatus::kNotApplicable);
  std::string text = std::to_string(points.size()) +
                     " points: " + std::to_string(CountStatus(points, PointStatus::kComputed)) + " done, " +
                     std::to_string(not_applicable) + " not applicable, " + std::to_string(failed) + " failed\n";
  const std::vector<Reason> reasons = Reasons(points);
  for (size_t i = 0; i < std::min(reasons.size(), kMostReasons); ++i) {
    text += "  " + std::to_string(reasons[i].count) + " x " + reasons[i].text + "; first at " +
            PlaceOf(study, reasons[i].first->point) + "\n";
  }
  if (reasons.size() > kMostReasons) {
    text += "  and " + std::to_string(reasons.size() - kMostReasons) + " reasons more\n";
  }
  return text;
}

}  // namespace saltus
