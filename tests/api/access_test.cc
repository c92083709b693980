#include "api/access.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"

namespace soundmap::api {
namespace {

using ::testing::HasSubstr;

constexpr std::int64_t kSecond_ns = 1'000'000'000;
constexpr std::int64_t kNow_ns = 1'700'000'000 * kSecond_ns;  // 2023-11-14T22:13:20Z

std::string TokenToml(const std::string& name, const std::string& secret, const std::string& role,
                      const std::string& rest) {
  return absl::StrCat("[[token]]\nname = \"", name, "\"\nsha256 = \"",
                      absl::BytesToHexString(Sha256(secret)), "\"\nrole = \"", role, "\"\n", rest,
                      "\n");
}

class AccessTest : public testing::Test {
 protected:
  AccessTest() { options_.token_file = ::testing::TempDir() + "/tokens.toml"; }
  ~AccessTest() override { std::filesystem::remove(options_.token_file); }

  // As those do who replace it at once.
  void WriteTokens(const std::string& text) {
    std::ofstream(options_.token_file + ".new") << text;
    std::filesystem::rename(options_.token_file + ".new", options_.token_file);
  }
  void Open() {
    access_ = Access::Create(options_, [this] { return now_ns_; }).value();
  }

  absl::StatusOr<Caller> WithToken(const std::string& secret, const std::string& peer = "ipv4:1") {
    return access_->CallerOf({.authorization = "Bearer " + secret, .peer = peer});
  }

  Access::Options options_;
  std::int64_t now_ns_ = kNow_ns;
  std::unique_ptr<Access> access_;
};

TEST(Sha256, IsThatOfFips180) {
  EXPECT_EQ(absl::BytesToHexString(Sha256("abc")),
            "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

TEST(Grant, EachRightIncludesThoseBefore) {
  for (const Right has : {Right::kRead, Right::kStream, Right::kWrite, Right::kAdmin}) {
    const Grant grant{.who = "x", .right = has, .robot = "r", .sites = {"a"}};
    for (const Right needed : {Right::kRead, Right::kStream, Right::kWrite, Right::kAdmin}) {
      EXPECT_EQ(grant.Check(needed, "a", "r").ok(), has >= needed);
      EXPECT_FALSE(grant.Check(needed, "b", "r").ok());
      EXPECT_FALSE(grant.Check(needed, "", "r").ok());
      EXPECT_FALSE(grant.Check(needed, "*", "r").ok());
    }
  }
}

TEST(Grant, ARobotStreamsAsItselfAndAWriterAsAny) {
  Grant grant{.who = "x", .right = Right::kStream, .robot = "r", .all_sites = true};
  EXPECT_TRUE(grant.Check(Right::kStream, "a", "r").ok());
  EXPECT_TRUE(absl::IsPermissionDenied(grant.Check(Right::kStream, "a", "other")));
  EXPECT_TRUE(absl::IsPermissionDenied(grant.Check(Right::kStream, "a", "")));
  grant.right = Right::kWrite;
  EXPECT_TRUE(grant.Check(Right::kStream, "a", "other").ok());
}

TEST(GrantFromCertificate, NamesRobotAndSites) {
  const auto grant = GrantFromCertificate(
      {"https://example.org", "soundmap://robots/r1", "soundmap://sites/a", "soundmap://sites/b"});
  ASSERT_TRUE(grant.ok()) << grant.status();
  EXPECT_EQ(grant->robot, "r1");
  EXPECT_EQ(grant->right, Right::kStream);
  EXPECT_TRUE(grant->Reaches("a") && grant->Reaches("b"));
  EXPECT_FALSE(grant->Reaches("c") || grant->Reaches("*") || grant->Reaches(""));
  EXPECT_TRUE(GrantFromCertificate({"soundmap://robots/r", "soundmap://sites/*"})->Reaches("c"));
  EXPECT_FALSE(GrantFromCertificate({"soundmap://robots/r"})->Reaches("c"));
}

TEST(GrantFromCertificate, RefusesWhatNamesNoRobot) {
  for (const std::vector<std::string>& uris : {std::vector<std::string>{},
                                               {"soundmap://sites/*"},
                                               {"soundmap://robots/"},
                                               {"soundmap://robots/../x", "soundmap://sites/*"},
                                               {"soundmap://robots/a/b"},
                                               {"soundmap://robots/a?sites=b"},
                                               {"soundmap://robots/*", "soundmap://sites/*"},
                                               {"soundmap://robots/a", "soundmap://robots/b"},
                                               {"soundmap://robots/a", "soundmap://sites/A"},
                                               {"SOUNDMAP://robots/a"}}) {
    EXPECT_TRUE(absl::IsUnauthenticated(GrantFromCertificate(uris).status()))
        << (uris.empty() ? "" : uris.front());
  }
}

TEST(TokenFile, SaysWhatIsWrong) {
  const std::string good = TokenToml("app", "s", "read", "sites = [\"a\"]");
  ASSERT_TRUE(TokenFile::Parse(good, "t").ok());
  ASSERT_TRUE(TokenFile::Parse("", "t").ok());
  const auto with = [&](const char* from, const char* to) {
    return absl::StrReplaceAll(good, {{from, to}});
  };
  for (const auto& [text, says] : std::vector<std::pair<std::string, std::string>>{
           {"= 1", "line 1"},
           {"[=]", "line 1"},
           {"x = 1", "'x'"},
           {"token = 1", "'token'"},
           {"refused_robots = 1", "refused_robots"},
           {with("\"app\"", "\"No Name\""), "No Name"},
           {with("sha256", "sha512"), "sha512"},
           {with("sha256 = \"", "sha256 = \"00"), "64 hexadecimal"},
           {with("sha256 = \"", "sha256 = \"zz"), "64 hexadecimal"},
           {with("\"read\"", "\"root\""), "role"},
           {with("\"read\"", "\"robot\""), "robot's name"},
           {with("[\"a\"]", "[\"../a\"]"), "../a"},
           {with("[\"a\"]", "\"a\""), "list of texts"},
           {with("[\"a\"]", "[1]"), "list of texts"},
           {with("[\"a\"]", "[]"), "lacks"},
           {with("sites = [\"a\"]", ""), "lacks"},
           {good + "robot = \"r\"", "robot's name"},
           {good + "expires = \"soon\"", "expires"},
           {good + "expires = 2027-01-01T00:00:00", "expires"},
           {good + "expires = 2027-01-01", "expires"}}) {
    const auto file = TokenFile::Parse(text, "t");
    ASSERT_FALSE(file.ok()) << text;
    EXPECT_TRUE(absl::IsInvalidArgument(file.status()));
    EXPECT_THAT(std::string(file.status().message()), HasSubstr(says)) << text;
  }
}

TEST_F(AccessTest, WithoutCredentialsAskedForAnybodyMayDoAnything) {
  options_.token_file.clear();
  Open();
  const auto caller = access_->CallerOf(Access::Shown());
  ASSERT_TRUE(caller.ok());
  EXPECT_TRUE(access_->Check(*caller, Right::kAdmin, "").ok());
}

TEST_F(AccessTest, ATokenGrantsWhatItsEntrySays) {
  WriteTokens(TokenToml("app", "secret", "read", "sites = [\"a\"]") +
              TokenToml("ops", "other", "admin", "sites = [\"*\"]"));
  Open();
  const auto app = WithToken("secret");
  ASSERT_TRUE(app.ok()) << app.status();
  EXPECT_EQ(app->grant.who, "token app");
  EXPECT_TRUE(access_->Check(*app, Right::kRead, "a").ok());
  EXPECT_TRUE(absl::IsPermissionDenied(access_->Check(*app, Right::kRead, "b")));
  EXPECT_TRUE(absl::IsPermissionDenied(access_->Check(*app, Right::kWrite, "a")));
  EXPECT_TRUE(access_->Check(*WithToken("other"), Right::kAdmin, "").ok());
  EXPECT_EQ(access_->refusals(Access::Refusal::kDenied), 2);
}

TEST_F(AccessTest, RefusesWhatIsNoKnownToken) {
  WriteTokens(TokenToml("app", "secret", "read", "sites = [\"a\"]"));
  Open();
  for (const std::string& authorization :
       {std::string(), std::string("secret"), std::string("Basic secret"), std::string("Bearer "),
        std::string("Bearer secret "), std::string("Bearer secre"),
        std::string("Bearer secret\0", 14),
        absl::StrCat("Bearer ", absl::BytesToHexString(Sha256("secret"))),
        "Bearer " + std::string(1 << 20, 'x')}) {
    const auto caller = access_->CallerOf({.authorization = authorization, .peer = "p"});
    EXPECT_TRUE(absl::IsUnauthenticated(caller.status())) << authorization.substr(0, 40);
  }
}

TEST_F(AccessTest, ATokenEndsAtItsTime) {
  WriteTokens(TokenToml("app", "secret", "read",
                        "sites = [\"a\"]\nexpires = 2023-11-15T00:13:21+02:00"));  // kNow_ns + 1 s
  Open();
  const auto caller = WithToken("secret");
  ASSERT_TRUE(caller.ok()) << caller.status();
  EXPECT_TRUE(access_->Recheck(*caller).ok());
  now_ns_ += kSecond_ns;
  EXPECT_TRUE(absl::IsUnauthenticated(WithToken("secret").status()));
  EXPECT_TRUE(absl::IsUnauthenticated(access_->Recheck(*caller)));
}

TEST_F(AccessTest, AChangedFileCountsWithinASecond) {
  const std::string both = TokenToml("app", "secret", "read", "sites = [\"a\"]") +
                           TokenToml("ops", "other", "admin", "sites = [\"*\"]");
  WriteTokens(both);
  Open();
  const auto app = WithToken("secret");
  const auto ops = WithToken("other");
  ASSERT_TRUE(app.ok() && ops.ok());
  WriteTokens(absl::StrReplaceAll(both, {{"\"app\"", "\"app2\""}, {"read", "write"}}));
  now_ns_ += kSecond_ns;
  EXPECT_EQ(WithToken("secret")->grant.right, Right::kWrite);
  EXPECT_TRUE(absl::IsUnauthenticated(access_->Recheck(*app)));
  EXPECT_TRUE(access_->Recheck(*ops).ok());
  // A token that was taken away is refused when it is shown again.
  WriteTokens(TokenToml("app", "secret", "read", "sites = [\"a\"]"));
  now_ns_ += kSecond_ns;
  EXPECT_TRUE(absl::IsUnauthenticated(WithToken("other").status()));
  EXPECT_TRUE(absl::IsUnauthenticated(access_->Recheck(*ops)));
  // A file that cannot be read changes nothing.
  WriteTokens("nonsense");
  now_ns_ += kSecond_ns;
  EXPECT_TRUE(WithToken("secret").ok());
}

TEST_F(AccessTest, ARefusedRobotIsOutAtOnce) {
  options_.robots_by_certificate = true;
  WriteTokens("");
  Open();
  const Access::Shown shown{.certificate_uris = {"soundmap://robots/r1", "soundmap://sites/a"},
                            .peer = "p"};
  const auto robot = access_->CallerOf(shown);
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_TRUE(access_->Check(*robot, Right::kStream, "a", "r1").ok());
  WriteTokens("refused_robots = [\"r1\"]");
  now_ns_ += kSecond_ns;
  EXPECT_TRUE(absl::IsUnauthenticated(access_->CallerOf(shown).status()));
  EXPECT_TRUE(absl::IsUnauthenticated(access_->Recheck(*robot)));
}

TEST_F(AccessTest, AFloodOfOneClientIsItsOwnAlone) {
  options_.calls_per_s = 5.0;
  WriteTokens(TokenToml("a", "one", "read", "sites = [\"*\"]") +
              TokenToml("b", "two", "read", "sites = [\"*\"]"));
  Open();
  const auto count = [&](const std::string& secret) {
    int taken = 0;
    for (int i = 0; i < 100; ++i) {
      const auto caller = WithToken(secret);
      taken += caller.ok();
      if (!caller.ok()) {
        EXPECT_TRUE(absl::IsResourceExhausted(caller.status()));
      }
    }
    return taken;
  };
  EXPECT_EQ(count("one"), 10);  // two seconds' worth at once
  EXPECT_EQ(count("two"), 10);
  now_ns_ += kSecond_ns;
  EXPECT_EQ(count("one"), 5);
  // Bad credentials are counted by address, and harm nobody who has good ones there.
  int unauthenticated = 0;
  for (int i = 0; i < 100; ++i) {
    unauthenticated += absl::IsUnauthenticated(WithToken("wrong").status());
  }
  EXPECT_EQ(unauthenticated, 20);
  EXPECT_TRUE(absl::IsUnauthenticated(WithToken("wrong", "ipv4:2").status()));
  now_ns_ += kSecond_ns;
  EXPECT_EQ(count("two"), 10);
}

TEST(RateLimit, KnowsABoundedNumberOfClients) {
  RateLimit limit(1.0);
  for (int i = 0; i < 100'000; ++i) EXPECT_TRUE(limit.Take(absl::StrCat(i), kNow_ns));
}

TEST_F(AccessTest, StartsOnlyWithGoodFiles) {
  const auto create = [&] { return Access::Create(options_, [] { return kNow_ns; }).status(); };
  EXPECT_THAT(std::string(create().message()), HasSubstr(options_.token_file));
  WriteTokens("nonsense");
  EXPECT_TRUE(absl::IsInvalidArgument(create()));
  WriteTokens("");
  EXPECT_TRUE(create().ok());
  options_.audit_log = "/proc/nowhere/audit";
  EXPECT_THAT(std::string(create().message()), HasSubstr("/proc/nowhere/audit"));
}

}  // namespace
}  // namespace soundmap::api
