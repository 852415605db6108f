// The reader of scenes from the YAML trees of scene files.
#pragma once

#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "saltus/scene/scene.h"
#include "scene/yaml_value.h"

namespace saltus::internal {

// Builds a Scene out of a YAML tree, and remembers the line of every path that it passes. Files of other problems that
// have parts of scene files in them are read by classes that inherit these parts.
class SceneReader {
 public:
  Scene Read(const YAML::Node& root);

  // Returns the line of a path, or of the innermost part of it that stands in the text.
  int LineOf(std::string path) const;

 protected:
  // A map with known keys only.
  struct Fields {
    Value map;
    std::unordered_map<std::string, Value> values;

    const Value* Find(const std::string& key) const;
    const Value& Require(const std::string& key, const std::string& expected) const;
  };

  Fields ReadFields(const Value& map, const std::vector<std::string>& known);
  std::vector<Value> ReadList(const Value& list, const std::string& expected);
  // Reads a list of `size` items.
  std::vector<Value> ReadTuple(const Value& list, std::size_t size, const std::string& expected);
  // Appends what is read of each entry of a list, if there is one under the key.
  template <typename Item>
  void ReadEach(const Fields& fields, const std::string& key, const std::string& expected,
                Item (SceneReader::*read)(const Value&), std::vector<Item>* items);
  Vec2d ReadVector(const Value& value);
  int ReadBodyName(const Value& value) const;
  std::vector<int> ReadBodyNames(const Value& value);

  PrescribedMotion ReadPath(const Value& value);
  Body ReadBody(const Value& value);
  Plane ReadPlane(const Value& value);
  EdgeSegment ReadSegment(const Value& value);
  EdgePolygon ReadPolygon(const Value& value);
  EdgeArc ReadArc(const Value& value);
  Pocket ReadPocket(const Value& value);
  TableFriction ReadTable(const Value& value);
  StateForce ReadForce(const Value& value);
  ContactParameters ReadContact(const Value& value);
  void ReadMaterials(const Value& value);
  int ReadMaterial(const Value& value) const;
  int ReadMaterialOf(const Fields& fields) const;
  MaterialPair ReadPair(const Value& value);
  std::vector<double> ReadBounds(const Value& value, size_t count);
  Control ReadControl(const Value& value);
  TerminalTerm::Quantity ReadQuantity(const Fields& fields);
  template <typename Term>
  void ReadWeight(const Fields& fields, Term* term);
  Vec2d ReadBoundsOf(const Fields& fields, const char* key, bool of_spin, double unbounded);
  std::optional<TerminalTerm::Region> ReadRegion(const Fields& fields, const TerminalTerm& term);
  TerminalTerm ReadTerm(const Value& value);
  RunningTerm ReadRunning(const Value& value);
  ViaTerm ReadVia(const Value& value);
  SpeedLimit ReadLimit(const Value& value);
  FreeDuration ReadFreeDuration(const Value& value);
  NoContact ReadNoContact(const Value& value);
  Objective ReadObjective(const Value& value);
  void ReadBodies(const Value& value);
  void ReadOptimize(const Value& value);
  void ReadUnknown(const Value& value);
  void FixDuration();

  Scene scene_;
  std::unordered_map<std::string, int> body_of_name_;
  std::unordered_map<std::string, int> line_of_path_;
};

}  // namespace saltus::internal
