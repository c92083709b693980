#include "api/token_file.h"

#include <openssl/crypto.h>
#include <openssl/sha.h>

#include <map>
#include <sstream>

#include "absl/strings/ascii.h"
#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/time/civil_time.h"
#include "absl/time/time.h"
#include "pipeline/toml.h"
#include "storage/names.h"

namespace soundmap::api {
namespace {

const std::map<std::string, Right> kRoles = {{"read", Right::kRead},
                                             {"robot", Right::kStream},
                                             {"write", Right::kWrite},
                                             {"admin", Right::kAdmin}};

absl::StatusOr<std::vector<std::string>> Texts(const toml::node& node, const std::string& where) {
  std::vector<std::string> texts;
  const toml::array* array = node.as_array();
  for (std::size_t i = 0; array != nullptr && i < array->size(); ++i) {
    const auto text = array->get(i)->value_exact<std::string>();
    if (!text) break;
    texts.push_back(*text);
  }
  if (array == nullptr || texts.size() != array->size()) {
    return absl::InvalidArgumentError(absl::StrCat(where, " is not a list of texts"));
  }
  return texts;
}

absl::StatusOr<std::int64_t> ExpiryFrom(const toml::node& node, const std::string& where) {
  const auto time = node.value_exact<toml::date_time>();
  if (!time || !time->offset) {
    return absl::InvalidArgumentError(
        absl::StrCat(where, " is not a time like 2027-01-01T00:00:00Z"));
  }
  const absl::CivilSecond civil(time->date.year, time->date.month, time->date.day, time->time.hour,
                                time->time.minute, time->time.second);
  return absl::ToUnixNanos(absl::FromCivil(civil, absl::UTCTimeZone()) -
                           absl::Minutes(time->offset->minutes));
}

absl::Status TakeSites(const toml::node& node, const std::string& where, Grant& grant) {
  auto sites = Texts(node, where);
  if (!sites.ok()) return sites.status();
  for (std::string& site : *sites) {
    if (site == "*") {
      grant.all_sites = true;
      continue;
    }
    const absl::Status valid = storage::ValidateName("site", site);
    if (!valid.ok()) {
      return absl::InvalidArgumentError(
          absl::StrCat(where, ": ", std::string(valid.message()), ", nor '*'"));
    }
    grant.sites.push_back(std::move(site));
  }
  return absl::OkStatus();
}

}  // namespace

std::string Sha256(const std::string& bytes) {
  std::string digest(SHA256_DIGEST_LENGTH, '\0');
  SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
         reinterpret_cast<unsigned char*>(digest.data()));
  return digest;
}

absl::StatusOr<TokenFile> TokenFile::Parse(const std::string& text, const std::string& path) {
  const toml::parse_result parsed = toml::parse(text, path);
  if (!parsed) {
    std::ostringstream what;
    what << parsed.error().description() << " (line " << parsed.error().source().begin.line << ')';
    return absl::InvalidArgumentError(absl::StrCat("the token file ", path, ": ", what.str()));
  }
  TokenFile file;
  for (auto&& [table_key, node] : parsed.table()) {
    if (table_key.str() == "refused_robots") {
      const auto robots = Texts(node, absl::StrCat(path, ": refused_robots"));
      if (!robots.ok()) return robots.status();
      file.refused_robots_.insert(robots->begin(), robots->end());
      continue;
    }
    const toml::array* tokens = node.as_array();
    if (table_key.str() != "token" || tokens == nullptr || !tokens->is_array_of_tables()) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": '", std::string(table_key.str()),
                       "' is neither refused_robots nor a [[token]]"));
    }
    for (const toml::node& token_node : *tokens) {
      const toml::table& token = *token_node.as_table();
      const std::string name = token["name"].value_or<std::string>("");
      const std::string where = absl::StrCat(path, ": token '", name, "'");
      const absl::Status valid = storage::ValidateName("token", name);
      if (!valid.ok()) {
        return absl::InvalidArgumentError(absl::StrCat(path, ": ", std::string(valid.message())));
      }
      Entry entry;
      entry.grant.who = absl::StrCat("token ", name);
      bool has_role = false;
      for (auto&& [key, value] : token) {
        const std::string field(key.str());
        const std::string field_where = absl::StrCat(where, ": ", field);
        const std::string value_text = value.value_or<std::string>("");
        absl::Status taken;
        if (field == "sha256") {
          entry.sha256 = absl::HexStringToBytes(value_text);
          if (value_text.size() != 2 * SHA256_DIGEST_LENGTH ||
              absl::BytesToHexString(entry.sha256) != absl::AsciiStrToLower(value_text)) {
            taken = absl::InvalidArgumentError(
                absl::StrCat(field_where, " is not 64 hexadecimal digits"));
          }
        } else if (field == "role") {
          const auto role = kRoles.find(value_text);
          has_role = role != kRoles.end();
          if (has_role) {
            entry.grant.right = role->second;
          } else {
            taken = absl::InvalidArgumentError(
                absl::StrCat(field_where, " is none of read, robot, write and admin"));
          }
        } else if (field == "robot") {
          entry.grant.robot = value_text;
          taken = storage::ValidateName(absl::StrCat(where, ": the robot"), value_text);
        } else if (field == "sites") {
          taken = TakeSites(value, field_where, entry.grant);
        } else if (field == "expires") {
          const auto expires_ns = ExpiryFrom(value, field_where);
          taken = expires_ns.status();
          if (taken.ok()) entry.grant.expires_ns = *expires_ns;
        } else if (field != "name") {
          taken = absl::InvalidArgumentError(absl::StrCat(where, " has no field '", field, "'"));
        }
        if (!taken.ok()) return taken;
      }
      if (entry.sha256.empty() || !has_role ||
          (!entry.grant.all_sites && entry.grant.sites.empty())) {
        return absl::InvalidArgumentError(absl::StrCat(where, " lacks sha256, role or sites"));
      }
      if ((entry.grant.right == Right::kStream) == entry.grant.robot.empty()) {
        return absl::InvalidArgumentError(
            absl::StrCat(where, ": the role robot and a robot's name go together"));
      }
      file.entries_.push_back(std::move(entry));
    }
  }
  return file;
}

const Grant* TokenFile::Find(const std::string& sha256) const {
  const Grant* found = nullptr;
  for (const Entry& entry : entries_) {
    if (sha256.size() == entry.sha256.size() &&
        CRYPTO_memcmp(sha256.data(), entry.sha256.data(), sha256.size()) == 0) {
      found = &entry.grant;
    }
  }
  return found;
}

}  // namespace soundmap::api
