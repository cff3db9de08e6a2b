// Unity 2022 or later with com.unity.cloud.gltfast: asks `kinegraph serve` for a clip and plays it. Compiled by the tests, not run.
using System.Collections;
using System.Text;
using GLTFast;
using UnityEngine;
using UnityEngine.Networking;

public class KinegraphClip : MonoBehaviour
{
    public string url = "http://127.0.0.1:8421";
    public string token = "";
    [TextArea] public string text = "a person walks forward";
    public float seconds = 4f;
    public int seed = 7;
    [Tooltip("A file of the server's --characters folder; empty for the body of kinegraph")]
    public string character = "";

    [System.Serializable]
    private class Wanted
    {
        public string text;
        public float seconds;
        public int seed;
        public string format = "glb";
        public float fps = 30f;
    }

    [System.Serializable]
    private class WantedOnCharacter : Wanted
    {
        public string character;
    }

    private IEnumerator Start()
    {
        Wanted wanted = character == "" ? new Wanted() : new WantedOnCharacter { character = character };
        wanted.text = text;
        wanted.seconds = seconds;
        wanted.seed = seed;
        string json = JsonUtility.ToJson(wanted); // {"text": ..., "seconds": ...}
        using (var request = new UnityWebRequest(url + "/v1/clips", "POST"))
        {
            request.uploadHandler = new UploadHandlerRaw(Encoding.UTF8.GetBytes(json));
            request.downloadHandler = new DownloadHandlerBuffer();
            request.SetRequestHeader("Content-Type", "application/json");
            if (token != "") request.SetRequestHeader("Authorization", "Bearer " + token);
            yield return request.SendWebRequest();
            if (request.result != UnityWebRequest.Result.Success)
            {
                Debug.LogError("kinegraph: " + request.error + " " + request.downloadHandler.text);
                yield break;
            }
            Load(request.downloadHandler.data);
        }
    }

    private async void Load(byte[] data)
    {
        var settings = new ImportSettings { AnimationMethod = AnimationMethod.Legacy };
        var file = new GltfImport();
        if (!await file.LoadGltfBinary(data, importSettings: settings) || !await file.InstantiateMainSceneAsync(transform))
        {
            Debug.LogError("kinegraph: the answer is no GLB");
            return;
        }
        var clips = file.GetAnimationClips();
        var player = GetComponentInChildren<Animation>();
        if (player != null && clips.Length > 0) player.Play(clips[clips.Length - 1].name);
    }
}
